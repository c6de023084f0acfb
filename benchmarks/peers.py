"""Regressions of other libraries on `crosstake` with 50 references, by the same error measures.

They are trained on the same data: principal components of the cleaned markers, and tuned weights.
Settings are chosen by cross-validation on the references if the library supports it.
"""

import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks._damage import DAMAGES
from benchmarks._takes import markers_of
from benchmarks.crosstake import (
    COLUMNS,
    choose_references,
    map_take,
    prepare,
    print_row,
    read_ruler,
    score,
)
from tests.conftest import SHARED_DATA
from usdface.usdio.references.read import read_references
from usdface.usdio.take.read import read_take

COUNT = 50
DIMENSIONS = 20
OURS = ("auto", "ridge", "d06")
Predict = Callable[[np.ndarray], np.ndarray]


def run() -> None:
    """Print a row per library method, and three of our methods; `crosstake` has all."""
    try:
        import sklearn
    except ImportError:
        print("skipped: scikit-learn is not installed")
        return
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    with tempfile.TemporaryDirectory() as name:
        folder, ruler = Path(name), read_ruler()
        truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
        prepare(folder, DAMAGES[0], truth)
        file = choose_references(folder, rig_file, COUNT)
        references = read_references(file)
        take = read_take(folder / "x.clean.take.usda")
        positions = markers_of(take).positions.reshape(take.frame_count, -1).astype(float)
        pairs = references.frames - take.first_frame
        centre = positions.mean(0)
        _, _, axes = np.linalg.svd(positions[::4] - centre, full_matrices=False)
        every = (positions - centre) @ axes[:DIMENSIONS].T
        every /= every[:, :1].std()
        print(f"{COUNT} references, {DIMENSIONS} components; scikit-learn {sklearn.__version__}\n")
        print(f"| method | {' | '.join(COLUMNS)} |")
        print(f"|---|{'---|' * len(COLUMNS)}")
        for label, predict in _peers(every[pairs], references.weights):
            weights = np.clip(predict(every), 0, 1)
            print_row(label, score(ruler, (references.shape_names, weights), truth, rig_file))
        for method in OURS:
            print_row(
                f"ours: {method}", score(ruler, map_take(file, rig_file, method), truth, rig_file)
            )


def _peers(x: np.ndarray, y: np.ndarray) -> Iterator[tuple[str, Predict]]:
    """Fit every method of other libraries to the pairs."""
    from scipy.interpolate import RBFInterpolator
    from sklearn.cross_decomposition import CCA, PLSRegression
    from sklearn.ensemble import ExtraTreesRegressor
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.linear_model import RidgeCV
    from sklearn.model_selection import GridSearchCV

    penalties = np.logspace(-5, 1, 13)
    grid = {"alpha": penalties[::2], "gamma": np.logspace(-3, 0, 7)}
    process = ConstantKernel(10.0) * RBF(5.0, (0.3, 300.0)) + WhiteKernel(1e-3, (1e-6, 0.1))
    models = {
        "scikit-learn RidgeCV": RidgeCV(penalties),
        "scikit-learn KernelRidge, Gaussian": GridSearchCV(
            KernelRidge(kernel="rbf"), grid, cv=5, scoring="neg_mean_squared_error"
        ),
        "scikit-learn GaussianProcessRegressor": GaussianProcessRegressor(
            process, normalize_y=True, random_state=0
        ),
        "scikit-learn PLSRegression, 10 components": PLSRegression(10, scale=False),
        "scikit-learn CCA, 10 components": CCA(10, scale=False, max_iter=2000),
        "scikit-learn ExtraTreesRegressor, 300": ExtraTreesRegressor(300, random_state=0),
    }
    kept = y.std(axis=0) > 0  # some methods divide by it
    for label, model in models.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # convergence warnings
            model.fit(x, y[:, kept])
        yield label, _whole(model.predict, y, kept)
    for kernel in ("thin_plate_spline", "cubic"):
        smooth = RBFInterpolator(x, y[:, kept], kernel=kernel, smoothing=1e-3, degree=1)
        yield f"SciPy RBFInterpolator, {kernel}", _whole(smooth, y, kept)


def _whole(predict: Predict, y: np.ndarray, kept: np.ndarray) -> Predict:
    """Predict all shapes; those constant over the references keep their value."""

    def predicted(x: np.ndarray) -> np.ndarray:
        out = np.tile(y[0], (len(x), 1))
        out[:, kept] = predict(x)
        return out

    return predicted
