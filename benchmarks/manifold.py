"""Regression over the surface: its errors on performed faces."""

import numpy as np
from scipy import sparse

from benchmarks._surface_subjects import Subject, demo_subject, recorded_subject
from usdface.model.surface.fit import (
    fit_surface_regression,
    surface_distances,
)
from usdface.numerics.measure.lip_gap import find_lip_pairs

WAYS = {
    "RBF, Euclidean": {"method": "rbf", "blend": 0.0},
    "RBF, blended": {"method": "rbf"},
    "RBF, blended, folds as the rest": {"method": "rbf", "folds": False},
    "GP, shared sample": {"sampler": "shared"},
    "GP, shared sample, folds as the rest": {"sampler": "shared", "folds": False},
    "GP, mode and Laplace": {"sampler": "map"},
    "GP, HMC": {},
    "GP, HMC, w chosen": {"blend": None},
    "GP, HMC, w = 1": {"blend": 1.0},
    "GP, HMC, eq. 7's shape": {"covariance_shape": "squared-exponential"},
}


def run(frames: int = 24) -> None:
    """Print accuracy on every face there is."""
    for subject in (recorded_subject(frames), demo_subject(frames)):
        if subject is None:
            print("ict_face with recorded curves: skipped, no shared data\n")
            continue
        accuracy(subject)


def accuracy(subject: Subject) -> None:
    """Print errors at unseen points, the lips' opening and what 95 % intervals hold."""
    distances = surface_distances(
        subject.points,
        subject.counts,
        subject.indices,
        subject.places.faces,
        subject.places.weights,
        marker_corners=subject.places.corners,
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
        for name, options in WAYS.items():
            found = fit_surface_regression(distances, moved, **options).deform(moved, of_axes=True)
            error = (found.mean - subject.motion)[:, moving]
            held = "-"
            if found.sd_of_axes is not None:
                inside = np.abs(error) < 1.96 * found.sd_of_axes[:, moving]
                held = f"{100 * inside.mean():.1f} %"
            rms = float(np.sqrt((error**2).mean()))
            print(
                f"| {noise} | {name} | {rms:.3f} | {_opening(subject, found.mean)} | {held} |",
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
