"""Accuracy of the regression over a surface, on faces with known motion."""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy import sparse

from benchmarks._surface_subjects import Subject, demo_subject, deviations_of_axes, recorded_subject
from usdface.core.arrays import FloatArray
from usdface.model.surface.distance import SurfaceDistances, surface_distances
from usdface.model.surface.fit import SurfaceModel
from usdface.model.surface.gp_surface import GpOptions, GpSurface, fit_gp_surface
from usdface.model.surface.rbf_surface import fit_rbf_surface
from usdface.numerics.measure.performance_error import find_lip_pairs

METHODS: dict[str, Callable[[SurfaceDistances, FloatArray], SurfaceModel]] = {
    "RBF, Euclidean": partial(fit_rbf_surface, blend=0.0),
    "RBF, blended": fit_rbf_surface,
    "RBF, blended, folds as the rest": partial(fit_rbf_surface, folds=False),
    "GP, shared sample": partial(fit_gp_surface, options=GpOptions(sampler="shared")),
    "GP, shared sample, folds as the rest": partial(
        fit_gp_surface, options=GpOptions(sampler="shared", folds=False)
    ),
    "GP, HMC": partial(fit_gp_surface, options=GpOptions()),
    "GP, HMC, w chosen": partial(fit_gp_surface, options=GpOptions(blend=None)),
    "GP, HMC, w = 1": partial(fit_gp_surface, options=GpOptions(blend=1.0)),
    "GP, HMC, eq. 7's shape": partial(fit_gp_surface, options=GpOptions(covariance="published")),
}


def run(frames: int = 24) -> None:
    """Print the accuracy on every face."""
    for subject in (recorded_subject(frames), demo_subject(frames)):
        if subject is None:
            print("ict_face with recorded curves: skipped, no shared data\n")
            continue
        accuracy(subject)


def accuracy(subject: Subject) -> None:
    """Print errors at points without markers, the lips' opening and the coverage of intervals."""
    distances = surface_distances(
        subject.points,
        subject.counts,
        subject.indices,
        subject.places,
    )
    moving = np.linalg.norm(subject.motion, axis=2).max(axis=0) > 0.5
    moving[subject.chosen] = False
    print(f"{subject.name}: {len(subject.chosen)} markers, {moving.sum()} unseen moving points\n")
    print("| noise [mm] | method | RMSE [mm] | lips' opening | in 95 % intervals |")
    print("|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    for noise in (0.0, 0.5):
        moved = subject.motion[:, subject.chosen]
        moved = moved + noise * rng.standard_normal(moved.shape)
        for name, fit in METHODS.items():
            fitted = fit(distances, moved)
            found = fitted.deform(moved)
            error = (found.mean - subject.motion)[:, moving]
            coverage = "-"
            if isinstance(fitted, GpSurface):
                inside = np.abs(error) < 1.96 * deviations_of_axes(fitted, moved)[:, moving]
                coverage = f"{100 * inside.mean():.1f} %"
            rms = float(np.sqrt((error**2).mean()))
            print(
                f"| {noise} | {name} | {rms:.3f} | {_opening(subject, found.mean)} | {coverage} |",
                flush=True,
            )
    print()


def _opening(subject: Subject, motion: np.ndarray) -> str:
    pairs = find_lip_pairs(
        subject.points, sparse.csr_array(subject.offsets), jaw_open=subject.jaw, mouth=subject.mouth
    )
    if pairs is None:
        return "-"

    def gap(of: np.ndarray) -> np.ndarray:
        return ((of[:, pairs.upper] - of[:, pairs.lower]) @ pairs.direction).mean(axis=1)

    true = gap(subject.motion)
    open_frames = true > 0.5 * true.max()
    return f"{100 * gap(motion)[open_frames].mean() / true[open_frames].mean():.0f} %"
