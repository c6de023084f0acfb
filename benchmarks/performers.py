"""Accuracy on simulated performers: other faces, other skin, other performances.

Each performer is a fixture rig with other proportions, shapes of other amplitude and direction,
skin that saturates, and markers on two lids, one or none. The performances are two Live Link
recordings, and one that combines the upper face of one moment with the mouth of another. References
are from the first half of the first; errors are those of all others. Markers are like cleaned ones:
noise of 0.15 mm, smoothed along the directions of the motion.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._takes import channel_of, weights_of
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.assets import MotionSpace, References, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.regions import skin_points
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import MAPPING_METHODS
from usdface.numerics.regression.cross_validation import surface_rms_mm
from usdface.numerics.regression.reference_design import design_gp_variance, whiten
from usdface.numerics.repair.smoothing import smooth_take
from usdface.usdio.rig.read import read_rig

Performer = tuple[str, int, int, float]
"""Rig, seed, lids with a marker, displacement at which skin saturates [mm]."""

PERFORMERS: tuple[Performer, ...] = (
    ("ict_face", 21, 2, 60.0),
    ("ict_face", 22, 1, 25.0),
    ("facecap_head", 23, 2, 60.0),
    ("facecap_head", 24, 0, 25.0),
)
UNSEEN_PERFORMERS = tuple((rig, seed + 10, lids, limit) for rig, seed, lids, limit in PERFORMERS)
"""Others of the same kinds, that chose nothing."""

COUNTS = (25, 50, 100)
MARKERS, NOISE_MM = 92, 0.15
DESIGN_DIMENSIONS = 32


@dataclass(frozen=True)
class Shapes:
    """Displacements of a rig's points by the performances' channels.

    Attributes
    ----------
    names : tuple of str
    places : (points, 3) float array
        Sampled points of the skin, in the neutral [mm].
    skin : (shapes, points, 3) float array
        Displacements of the same [mm].
    gram : (shapes, shapes) float array
        Mean dot products of the displacements of all points [mm^2].
    """

    names: tuple[str, ...]
    places: np.ndarray
    skin: np.ndarray
    gram: np.ndarray


@dataclass(frozen=True)
class Acted:
    """References of a performer, and other takes of the performer.

    Attributes
    ----------
    references : References
    shapes : Shapes
    takes : tuple of (name, markers, true weights)
    """

    references: References
    shapes: Shapes
    takes: tuple[tuple[str, np.ndarray, np.ndarray], ...]


def run(
    counts: tuple[int, ...] = COUNTS, methods: tuple[str, ...] = (), *, quick: bool = False
) -> None:
    """Print vertex RMS [mm] and blink bias of each method and performance.

    `quick` runs one number of references and the main methods.
    """
    if not (SHARED_DATA / "rigs").is_dir():
        print(f"skipped: no rigs in {SHARED_DATA}")
        return
    if quick:
        counts, methods = (50,), methods or ("auto", "kernel_cca", "ridge")
    for count in counts:
        print(f"{count} references: vertex RMS [mm] and blink bias, mean over performers\n")
        print("| method | second half | other performance | other combinations |")
        print("|---|---|---|---|")
        rows: dict[str, list[Any]] = {
            method: [] for method in methods or ("auto", *MAPPING_METHODS)
        }
        for performer in PERFORMERS:
            for method, figures in _score_performer(performer, count, tuple(rows)).items():
                rows[method].append(figures)
        for method, figures in rows.items():
            mean = np.mean(figures, axis=0)
            print(f"| {method} | {_cells(mean)} |", flush=True)
        first, each = next(iter(rows.items()))
        print(f"\nof these {first}, by performer\n")
        print("| performer | lid markers | second half | other performance | other combinations |")
        print("|---|---|---|---|---|")
        for (rig, seed, lids, _), figures in zip(PERFORMERS, each, strict=True):
            print(f"| {rig}, {seed} | {lids} | {_cells(figures)} |", flush=True)
        print()
    print("brows, which no reference moves, in the other performance: share of their motion\n")
    print("| performer | share | error, relative to the motion |\n|---|---|---|")
    for performer in (*PERFORMERS, *UNSEEN_PERFORMERS):
        share, error = _brow_share(performer)
        print(f"| {performer[0]}, {performer[1]} | {share:.2f} | {error:.2f} |", flush=True)


def _brow_share(performer: Performer) -> tuple[float, float]:
    """Return the slope of predicted over true motion of the brows, and the relative error.

    With references whose brows are at rest; both over the surface.
    """
    acted = act(performer, 50, still="brow")
    (_, markers, truth), shapes = acted.takes[1], acted.shapes
    predicted = WeightPredictor(_trained(acted, "auto")).predict(markers).weights
    brows = [i for i, name in enumerate(shapes.names) if name.startswith("brow")]
    root = np.linalg.cholesky(shapes.gram[np.ix_(brows, brows)] + 1e-9 * np.eye(len(brows)))
    wanted, found = (each[:, brows] @ root for each in (truth, predicted))
    share = (wanted * found).sum() / (wanted**2).sum()
    return float(share), float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def _cells(figures: Iterable[Iterable[float]]) -> str:
    return " | ".join(f"{error:.3f}, {blink:+.3f}" for error, blink in figures)


def _score_performer(
    performer: Performer, count: int, methods: tuple[str, ...]
) -> dict[str, list[tuple[float, float]]]:
    acted = act(performer, count)
    found = {}
    for method in methods:
        mapping = _trained(acted, method)
        found[method] = [
            _figures(mapping, acted.shapes, markers, truth) for _, markers, truth in acted.takes
        ]
    return found


def _trained(acted: Acted, method: str) -> TrainedMapping:
    return train_mapping(
        acted.references,
        ranges=np.tile([0.0, 1.0], (len(acted.shapes.names), 1)),
        gram=acted.shapes.gram,
        skin=acted.shapes.skin,
        method=method,
    )


def act(performer: Performer, count: int, *, still: str = "-") -> Acted:
    """Simulate a performer's takes, and choose references from the first half.

    Shapes whose name begins with `still` do not move in the first performance.
    """
    rig, seed, lids, limit = performer
    weights, names = performance("livelink_alex/alex_rom_3.csv", 30)
    weights[:, [name.startswith(still) for name in names]] = 0
    other, _ = performance("livelink_jmtechart/MySlate_3_Jason_Millers_iPhone.csv", 60)
    shapes = shapes_of_rig(SHARED_DATA / "rigs" / f"{rig}.usdc", names)
    upper = np.array([name.startswith(("brow", "eye")) for name in names])
    mixed = weights.copy()
    mixed[:, upper] = weights[::-1][:, upper]
    places, basis = _face(shapes, seed, lids)
    rng = np.random.default_rng(seed)
    half = len(weights) // 2
    takes = [clean_motion(places, basis, w, limit, NOISE_MM, rng) for w in (weights, other, mixed)]
    motion = fit_motion_space([takes[0][:half].astype(np.float32)])
    chosen = choose_pairs(takes[0][:half], motion, count)
    references = References(
        marker_names=tuple(f"m{i}" for i in range(len(places))),
        shape_names=names,
        markers=takes[0][chosen],
        weights=weights[chosen],
        frames=chosen,
        rate=60.0,
        takes=("take",) * count,
        tuned=np.ones(count, dtype=bool),
        rigid=(),
        neutral=places,
        rig_file=Path(f"{rig}.usdc"),
        rig_prim="/",
        motion=motion,
    )
    return Acted(
        references,
        shapes,
        (
            ("second half", takes[0][half:], weights[half:]),
            ("other performance", takes[1], other),
            ("other combinations", takes[2], mixed),
        ),
    )


def choose_pairs(markers: np.ndarray, motion: MotionSpace, count: int) -> np.ndarray:
    """Return frames that a Gaussian process of the markers' motion learns most from."""
    kept = DESIGN_DIMENSIONS
    rows = (markers.reshape(len(markers), -1) - motion.mean) @ motion.components[:kept].T
    return np.asarray(design_gp_variance(whiten(rows, motion.variances[:kept]), count).chosen)


def _figures(
    mapping: TrainedMapping, shapes: Shapes, markers: np.ndarray, truth: np.ndarray
) -> tuple[float, float]:
    error = WeightPredictor(mapping).predict(markers).weights - truth
    blinks = [i for i, name in enumerate(shapes.names) if name.startswith("eyeblink")]
    peaks = truth[:, blinks] > np.quantile(truth[:, blinks], 0.97, axis=0)
    return surface_rms_mm(error, shapes.gram), float(error[:, blinks][peaks].mean())


def performance(file: str, rate: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return a recording's weights at 60 frames per second, of channels that every rig has."""
    source = weights_of(read_capture(SHARED_DATA / file).take)
    rows = np.linspace(0, len(source.values) - 1, len(source.values) * 60 // rate)
    columns = [i for i, name in enumerate(source.names[:61]) if _is_shape(name)]
    values = np.clip(source.values[:, columns].astype(float), 0, 1)
    track = [np.interp(rows, np.arange(len(values)), column) for column in values.T]
    return np.array(track).T, tuple(source.names[i].lower() for i in columns)


def _is_shape(name: str) -> bool:
    return not name.lower().startswith(("head", "lefteye", "righteye", "tongue"))


def shapes_of_rig(file: Path, names: tuple[str, ...]) -> Shapes:
    """Return the displacements by channels that are named as on phones."""
    rig = read_rig(file)
    deformer = Deformer(rig)
    dense = deformer.shapes.target_offsets().toarray().reshape(len(rig.shapes), -1, 3)
    own = [channel_of(name) for name in rig.shapes]
    offsets = np.zeros((len(names), *dense.shape[1:]))
    for i, name in enumerate(names):
        sides = [own.index(s) for s in (name, name + "left", name + "right") if s in own]
        offsets[i] = dense[sides].sum(axis=0)
    flat = offsets.reshape(len(names), -1)
    gram = flat @ flat.T / offsets.shape[1]
    chosen = skin_points(flat)
    return Shapes(names, deformer.neutral[chosen], offsets[:, chosen], gram)


def _face(shapes: Shapes, seed: int, lids: int) -> tuple[np.ndarray, np.ndarray]:
    """Return marker positions of a performer, and their displacements by each shape."""
    rng = np.random.default_rng(seed)
    # Candidates for markers are the sampled skin.
    skin = shapes.skin
    reach = np.linalg.norm(skin, axis=2)
    lid = [reach[shapes.names.index(f"eyeblink{side}")] for side in ("left", "right")]
    chosen = [int(row.argmax()) for row in lid[:lids]]
    open_points = np.all([row < 0.35 * row.max() for row in lid], axis=0)
    pool = rng.permutation(np.flatnonzero(open_points))
    chosen += [int(i) for i in pool[: MARKERS - lids]]
    gain = np.exp(0.2 * rng.standard_normal((len(skin), 1, 1)))
    turn = Rotation.from_rotvec(0.1 * rng.standard_normal((len(skin), 3))).as_matrix()
    proportions = rng.uniform(0.86, 1.14, 3)
    local = 1 + 0.1 * rng.standard_normal((len(chosen), 1))
    basis = np.einsum("smc,sdc->smd", skin[:, chosen], turn) * gain * local * proportions
    return rng.uniform(-70, 70, size=(len(chosen), 3)), basis


def clean_motion(
    places: np.ndarray,
    basis: np.ndarray,
    weights: np.ndarray,
    limit: float,
    noise_mm: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return markers on saturating skin, with noise, smoothed as `clean` does."""
    moved = np.einsum("fs,smc->fmc", weights, basis, optimize=True)
    far = np.linalg.norm(moved, axis=2, keepdims=True)
    moved *= limit * np.tanh(far / limit) / np.maximum(far, 1e-9)
    positions = places + moved + noise_mm * rng.standard_normal(moved.shape)
    smooth_take(positions, noise=np.full(len(places), noise_mm))
    return positions
