"""A small made-up face: shapes that move markers, a performance, references of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Markers, References, TrainedMapping
from usdface.model.mapping.head_space import MappedMarkers, find_head_space
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.regions import offsets_at, skin_points
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.virtual_markers import VirtualMarkers

MARKERS, RIGID, SHAPES = 24, 5, 6


@dataclass(frozen=True)
class SyntheticFace:
    """Everything that is known about a made-up face and its take."""

    neutral: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray
    positions: np.ndarray
    names: tuple[str, ...]
    rigid: tuple[str, ...]
    gram: np.ndarray
    ranges: np.ndarray


def synthetic_face(
    *, frames: int = 1200, bend: float = 0.0, noise: float = 0.02, seed: int = 0
) -> SyntheticFace:
    """Make a face whose markers answer to weights, straight or bent, and a performance."""
    rng = np.random.default_rng(0)  # the face is the same whatever the performance
    neutral = rng.uniform(-60, 60, size=(MARKERS, 3))
    shapes = rng.normal(size=(SHAPES, MARKERS, 3)) * 4.0
    shapes[:, :RIGID] = 0.0
    squares = rng.normal(size=(SHAPES, MARKERS, 3)) * 4.0
    squares[:, :RIGID] = 0.0
    rng = np.random.default_rng(seed + 1)
    time = np.arange(frames)[:, None] / 60.0
    waves = np.sin(2 * np.pi * (time * rng.uniform(0.2, 0.9, SHAPES) + rng.uniform(0, 1, SHAPES)))
    weights = np.clip(0.5 + 0.6 * waves, 0.0, 1.0)
    moved = np.einsum("fs,smc->fmc", weights, shapes)
    moved += bend * np.einsum("fs,smc->fmc", weights**2, squares)
    positions = neutral + moved + noise * rng.normal(size=moved.shape)
    names = tuple(f"m{i:02d}" for i in range(MARKERS))
    return SyntheticFace(
        neutral=neutral,
        shapes=shapes,
        weights=weights,
        positions=positions,
        names=names,
        rigid=names[:RIGID],
        gram=np.einsum("smc,tmc->st", shapes, shapes) / MARKERS,
        ranges=np.tile([0.0, 1.0], (SHAPES, 1)),
    )


def references_of(face: SyntheticFace, chosen: np.ndarray) -> References:
    """Pair some frames of a face's take with their true weights."""
    return References(
        marker_names=face.names,
        shape_names=tuple(f"shape{i}" for i in range(SHAPES)),
        markers=face.positions[chosen],
        weights=face.weights[chosen],
        frames=np.asarray(chosen, dtype=np.int64),
        takes=("take",) * len(chosen),
        tuned=np.ones(len(chosen), dtype=bool),
        rigid=face.rigid,
        neutral=face.neutral,
        rig_file=Path("rig.usd"),
        rig_prim="/Rig",
        motion=fit_motion_space([face.positions], dimensions=20, sample_count=300),
    )


def markers_of(face: SyntheticFace, **changes: object) -> Markers:
    """Bundle a face's take as stabilised markers."""
    frames = len(face.positions)
    given: dict[str, object] = {
        "names": face.names,
        "positions": face.positions.astype(np.float32),
        "visible": np.ones((frames, MARKERS), dtype=bool),
        "confidence": np.ones((frames, MARKERS), dtype=np.float32),
        "rigid": face.rigid,
        "space": "stabilized",
    }
    return Markers(**(given | changes))  # type: ignore[arg-type]


def skin_samples(skin: FaceSkin, virtual: VirtualMarkers) -> IntArray:
    """Return the indices of the samples of a skin on which markers were placed."""
    rows = [
        np.flatnonzero((skin.corners == corners).all(1) & (skin.shares == shares).all(1))[0]
        for corners, shares in zip(virtual.points, virtual.weights, strict=True)
    ]
    return np.array(rows)


def sample_skin(offsets: FloatArray | sparse.sparray) -> FloatArray:
    """Return the displacements of `skin_points` by each shape at 1: (shapes, points, 3) [mm]."""
    return offsets_at(offsets, skin_points(offsets))


def align_markers(mapping: TrainedMapping, markers: Markers, *, rate: float) -> MappedMarkers:
    """Align a whole take, at a rate in frames per second, with a mapping; see `find_head_space`."""
    return find_head_space(face_of_mapping(mapping), markers, rate=rate).place(markers)
