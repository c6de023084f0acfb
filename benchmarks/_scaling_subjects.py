"""Calls whose scaling is measured, on a simulated face of increasing sizes.

Run as a program, it prints a line of JSON per measurement: BLAS reads the number of threads when
numpy is imported, so that measuring with one thread needs a separate process.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

import numpy as np

from tests.numerics.simulated_face import simulate_face
from tests.numerics.surface.test_geodesic import sphere
from tests.usdio.small_rig import small_rig
from usdface.core.assets import References, RigMesh, TrainedMapping
from usdface.demo.rig import demo_rig
from usdface.media.face.camera import frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.face.subdivision import catmull_clark
from usdface.model.mapping.motion_space import fit_motion_space, motion_from_pca
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.selection.design import WeightProposals, choose_by_design, selection_space
from usdface.numerics.regression.pca import fit_pca
from usdface.numerics.repair.cleaning import clean_markers
from usdface.numerics.rigid.stabilization import stabilize
from usdface.numerics.surface.geodesic import geodesic_distances
from usdface.numerics.surface.surface_places import SurfacePoints
from usdface.numerics.surface.triangulation import triangulate
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

MARKERS, SHAPES, PAIRS, BLOCK = 102, 46, 50, 4096
ON = f"{MARKERS} markers"
HEADS = (19_551, 76_944, 305_274)
"""Points of the demo's head, without subdivision and subdivided once and twice."""

NOISE_MM = 0.1
SKIN_POINTS = 900
ENOUGH_SECONDS, MOST_RUNS = 0.4, 5
"""Short calls are repeated for this time, at most so often; the shortest run is used."""

LINEAR = 1.1
"""Limit of the exponent of linear calls: cache misses at large sizes increase it above 1."""

Work = Callable[[], object]


@dataclass(frozen=True)
class Subject:
    """One call, in one measure of size.

    Attributes
    ----------
    call, within : str
        The function, and the measure of size.
    sizes : tuple of int
    most : float
        Limit of the exponent, from the complexity of the call.
    fixed : str
        Description of the constant sizes.
    prepare : callable
        Returns the timed function for a size and a folder.
    """

    call: str
    within: str
    sizes: tuple[int, ...]
    most: float
    fixed: str
    prepare: Callable[[int, Path], Work]


@dataclass(frozen=True)
class _Actor:
    """A face whose shapes move patches, and a performance captured by markers."""

    skin: np.ndarray
    weights: np.ndarray
    clouds: np.ndarray


@cache
def _actor(frames: int, shapes: int) -> _Actor:
    rng = np.random.default_rng(0)
    points = rng.uniform(-70, 70, (SKIN_POINTS, 3))
    centres = points[rng.choice(SKIN_POINTS, shapes)]
    reach = np.linalg.norm(points - centres[:, None], axis=2)
    skin = np.exp(-0.5 * (reach / 15.0) ** 2)[:, :, None] * rng.normal(0, 4.0, (shapes, 1, 3))
    seconds = np.arange(frames)[:, None] / 120.0
    waves = np.sin(seconds * rng.uniform(0.5, 6.0, shapes) + rng.uniform(0, 6, shapes))
    weights = np.clip(1.5 * waves - 0.7, 0.0, 1.0)
    carriers = rng.choice(SKIN_POINTS, MARKERS, replace=False)
    moved = (weights @ skin[:, carriers].reshape(shapes, -1)).reshape(frames, MARKERS, 3)
    moved += points[carriers] + rng.normal(0, NOISE_MM, moved.shape)
    return _Actor(skin, weights, moved.astype(np.float32))


def _clean(size: int, folder: Path, *, by: str) -> Work:
    frames, markers = (size, MARKERS) if by == "frames" else (2_000, size)
    face = simulate_face(
        frames=frames, markers=markers - 8, swapped_share=0.02, dropout_share=0.02, stray_count=4
    )
    neutral = int(np.argmax(face.visible[: frames // 4].sum(axis=1)))
    captured = face.captured.astype(np.float32)
    return lambda: clean_markers(captured, face.visible, rigid=face.rigid, neutral=neutral)


def _stabilize(size: int, folder: Path) -> Work:
    face = simulate_face(frames=size, markers=MARKERS - 8)
    captured = face.captured.astype(np.float32)
    return lambda: stabilize(captured, face.visible, rigid=face.rigid, neutral=0)


def _training(*, pairs: int, shapes: int, method: str) -> Callable[[], TrainedMapping]:
    actor = _actor(6_000, shapes)
    picks = np.linspace(0, len(actor.weights) - 1, pairs).astype(int)
    flat = actor.skin.reshape(shapes, -1)
    references = References(
        marker_names=tuple(f"m{index}" for index in range(MARKERS)),
        shape_names=tuple(f"shape{index}" for index in range(shapes)),
        markers=actor.clouds[picks].astype(np.float64),
        weights=actor.weights[picks],
        frames=picks,
        takes=("take",) * pairs,
        tuned=np.ones(pairs, np.bool_),
        rigid=(),
        neutral=actor.clouds[0].astype(np.float64),
        rig_file=Path("rig.usd"),
        rig_prim="/Rig",
        motion=fit_motion_space([actor.clouds]),
    )
    return lambda: train_mapping(
        references,
        ranges=np.tile([0.0, 1.0], (shapes, 1)),
        gram=flat @ flat.T / SKIN_POINTS,
        skin=actor.skin,
        method=method,
    )


_TRAINED: dict[tuple[int, int, str], TrainedMapping] = {}
"""Mappings of the timed training, reused for the timing of predictions."""


def _train(size: int, folder: Path, *, by: str, method: str) -> Work:
    pairs, shapes = (size, SHAPES) if by == "references" else (PAIRS, size)
    training = _training(pairs=pairs, shapes=shapes, method=method)

    def work() -> None:
        _TRAINED[pairs, shapes, method] = training()

    return work


def _mapping(pairs: int, shapes: int, method: str) -> TrainedMapping:
    key = pairs, shapes, method
    if key not in _TRAINED:
        _TRAINED[key] = _training(pairs=pairs, shapes=shapes, method=method)()
    return _TRAINED[key]


def _predict(size: int, folder: Path, *, by: str, method: str) -> Work:
    frames, pairs, shapes = BLOCK, PAIRS, SHAPES
    if by == "frames":
        frames = size
    elif by == "references":
        pairs = size
    else:
        shapes = size
    predictor = WeightPredictor(_mapping(pairs, shapes, method))
    clouds = _actor(6_000, shapes).clouds

    def work() -> None:
        for start in range(0, frames, BLOCK):  # as in `map`, in constant memory
            predictor.predict(clouds[: min(BLOCK, frames - start)])

    return work


def _select(size: int, folder: Path) -> Work:
    actor = _actor(size, SHAPES)
    packed = actor.clouds.reshape(size, -1).astype(np.float64)
    sample = np.linspace(0, size - 1, 1_000).astype(int)
    motion = motion_from_pca(fit_pca(packed[sample], dimensions=60), packed[sample])
    names = tuple(f"shape{index}" for index in range(SHAPES))
    space = selection_space(motion, actor.weights[sample], names)
    features = space.features((packed - motion.mean) @ motion.components.T)
    flat = actor.skin.reshape(SHAPES, -1)
    proposals = WeightProposals(
        features=features[sample],
        weights=actor.weights[sample],
        of_rows=lambda rows: actor.weights[rows],
        gram=flat @ flat.T / SKIN_POINTS,
    )
    none, everything = np.zeros(0, np.int64), np.ones(size, np.bool_)
    return lambda: choose_by_design(
        features, PAIRS, already=none, candidates=everything, proposals=proposals
    )


def _write(size: int, folder: Path, *, by: str) -> Work:
    frames, shapes = (size, SHAPES) if by == "frames" else (4_000, size)
    rig_file = folder / "rig.usda"
    write_rig(rig_file, small_rig())
    rig = read_rig(rig_file)
    rng = np.random.default_rng(0)
    waves = rng.random((BLOCK, shapes)).astype(np.float32)

    def work() -> None:
        with writing_performance(
            folder / f"{by}.usda",
            make_header(
                rig,
                shape_names=tuple(f"shape{index}" for index in range(shapes)),
                rate=Fraction(120),
                first_frame=0,
                last_frame=frames - 1,
            ),
            rig,
        ) as writer:
            for start in range(0, frames, BLOCK):
                # Blocks differ, since USD stores equal samples once.
                shade = np.float32(1 - 0.5 * start / frames)
                writer.append(waves[: min(BLOCK, frames - start)] * shade)

    return work


@cache
def _head(steps: int) -> tuple[RigMesh, ...]:
    """Return the demo's meshes, subdivided `steps` times."""
    if steps == 0:
        return tuple(replace(mesh, shapes=()) for mesh in demo_rig().meshes)
    finer = []
    for mesh in _head(steps - 1):
        cut = catmull_clark(mesh.face_counts, mesh.face_indices, point_count=len(mesh.points))
        finer.append(
            replace(
                mesh,
                points=np.asarray(cut.matrix @ mesh.points),
                face_counts=cut.face_counts,
                face_indices=cut.face_indices,
                colors=None if mesh.colors is None else np.asarray(cut.matrix @ mesh.colors),
            )
        )
    return tuple(finer)


_READY: dict[int, FaceRenderer] = {}


def _make_ready(size: int, folder: Path) -> Work:
    meshes = _head(HEADS.index(size))
    points = sum(len(mesh.points) for mesh in meshes)
    if points != size:
        raise SystemExit(f"the demo's head has {points:,} points, not {size:,}: correct HEADS")

    def work() -> None:
        _READY[size] = FaceRenderer(meshes)

    return work


def _draw(size: int, folder: Path) -> Work:
    renderer, camera = _READY[size], frame_rig(demo_rig().meshes, yaw_degrees=12)
    points = np.concatenate([mesh.points for mesh in _head(HEADS.index(size))])
    return lambda: renderer.render(points, camera=camera, width=320, height=320)


def _geodesic(size: int, folder: Path) -> Work:
    columns = 200
    points, counts, indices = sphere(size // columns, columns, 90.0)
    corners, owners = triangulate(counts, indices)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(corners), MARKERS)
    weights = rng.dirichlet([1, 1, 1], MARKERS)
    places = SurfacePoints(owners[chosen], corners[chosen], weights)
    return lambda: geodesic_distances(points, counts, indices, places, metric="dijkstra")


FRAMES = (4_096, 8_192, 16_384, 32_768)
REFERENCES = {"ridge": (50, 100, 200, 400, 800), "face_map": (13, 25, 50, 100)}
RIG_SHAPES = {"ridge": (46, 92, 184, 368, 736), "face_map": (23, 46, 92, 184)}


def _of_method(method: str) -> tuple[Subject, ...]:
    """Return training and predictions of one method."""
    pairs, shapes = REFERENCES[method], RIG_SHAPES[method]
    train, predict = f"train {method}", f"map by {method}"
    by = {
        within: (
            partial(_train, by=within, method=method),
            partial(_predict, by=within, method=method),
        )
        for within in ("frames", "references", "shapes")
    }
    many, few = f"{BLOCK:,} frames", f"{PAIRS} references"
    rig = f"{SHAPES} shapes"
    return (
        # One decomposition of a (references, references) matrix.
        Subject(train, "references", pairs, 3.0, rig, by["references"][0]),
        # Errors are weighted by the Gram matrix of the shapes.
        Subject(train, "shapes", shapes, 2.0, few, by["shapes"][0]),
        Subject(predict, "frames", FRAMES, LINEAR, f"{few}, {rig}", by["frames"][1]),
        Subject(predict, "references", pairs, LINEAR, f"{many}, {rig}", by["references"][1]),
        Subject(predict, "shapes", shapes, LINEAR, f"{many}, {few}", by["shapes"][1]),
    )


SUBJECTS = (
    Subject(
        "clean", "frames", (750, 1_500, 3_000, 6_000), LINEAR, ON, partial(_clean, by="frames")
    ),
    # Each marker is predicted from all others.
    Subject(
        "clean", "markers", (30, 60, 120, 240), 2.0, "2,000 frames", partial(_clean, by="markers")
    ),
    Subject("stabilise", "frames", FRAMES, LINEAR, ON, _stabilize),
    Subject("select", "frames", (3_000, 6_000, 12_000, 24_000), LINEAR, f"{PAIRS} chosen", _select),
    *_of_method("ridge"),
    *_of_method("face_map"),
    Subject("write", "frames", FRAMES, LINEAR, f"{SHAPES} shapes", partial(_write, by="frames")),
    Subject(
        "write",
        "shapes",
        (46, 92, 184, 368, 736),
        LINEAR,
        "4,000 frames",
        partial(_write, by="shapes"),
    ),
    Subject("make a head ready", "points", HEADS, LINEAR, "once a rig", _make_ready),
    Subject("draw a head", "points", HEADS, LINEAR, "320 × 320 pixels, final", _draw),
    # Per marker, each point is taken from a heap once: n log n.
    Subject("distances over edges", "points", (5_000, 10_000, 20_000, 40_000), 1.2, ON, _geodesic),
)


def _seconds(work: Work, *, least_runs: int) -> float:
    """Return the shortest processor time of repeated runs [s]."""
    taken: list[float] = []
    while len(taken) < least_runs or (len(taken) < MOST_RUNS and sum(taken) < ENOUGH_SECONDS):
        begun = time.process_time()
        work()
        taken.append(time.process_time() - begun)
    return min(taken)


def main() -> None:
    """Measure all sizes; with ``--quick`` without the largest."""
    for number, subject in enumerate(SUBJECTS):
        for size in subject.sizes[: -1 if "--quick" in sys.argv else None]:
            with tempfile.TemporaryDirectory() as folder:
                # The first run imports modules and fills caches.
                least = 2 if size == subject.sizes[0] else 1
                seconds = _seconds(subject.prepare(size, Path(folder)), least_runs=least)
            measured = {"subject": number, "size": size, "seconds": seconds}
            print(json.dumps(measured), flush=True)


if __name__ == "__main__":
    main()
