"""Faces with known motion of every point, and markers on some of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from benchmarks._takes import channel_of, weights_of
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.assets import RigMesh
from usdface.core.deformer import Deformer
from usdface.demo.acting import performance
from usdface.demo.capture import demo_markers
from usdface.demo.rig import demo_rig, make_head, mesh_points
from usdface.demo.sculpt import CHARACTER
from usdface.model.surface.gp_surface import GpSurface, _rows_of_axes
from usdface.numerics.manifold.posterior_prediction import (
    average_dual_weights,
    frame_factors,
    predict_variance,
)
from usdface.numerics.surface.surface_places import SurfacePoints, places_at_points
from usdface.usdio.rig.read import read_rig


@dataclass(frozen=True)
class Subject:
    """A mesh, the points with markers, and the motion of all points."""

    name: str
    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    chosen: np.ndarray
    places: SurfacePoints
    motion: np.ndarray
    """(frames, points, 3) [mm]"""
    offsets: sparse.csc_array
    """(shapes, 3 * points): displacements of the shapes, from which the lips are found [mm]."""
    jaw: int
    mouth: np.ndarray


def demo_subject(frames: int, *, markers: int | None = None) -> Subject:
    """Return the demo's skin, moved by the demo's performance."""
    head = make_head(CHARACTER)
    rig, clip = demo_rig(CHARACTER), performance().weights
    own = mesh_points(head)["skin"]
    place = np.full(len(head.points), -1)
    place[own] = np.arange(len(own))
    chosen = place[demo_markers(head).points]
    if markers:
        chosen = chosen[np.linspace(0, len(chosen) - 1, markers).astype(int)]
    weights = np.zeros((len(clip.values), len(rig.shapes)))
    for column, name in enumerate(rig.shapes):
        if name in clip.names:
            weights[:, column] = clip.values[:, clip.names.index(name)]
    return _subject("the demo's character", rig, rig.meshes[0], weights, frames, chosen)


def recorded_subject(frames: int, *, markers: int = 42) -> Subject | None:
    """Return ICT's face, moved by recorded curves, with markers where it moves."""
    if not (SHARED_DATA / "rigs").is_dir():
        return None
    rig = read_rig(SHARED_DATA / "rigs" / "ict_face.usdc")
    clip = weights_of(read_capture(SHARED_DATA / Path("livelink_alex/alex_rom_3.csv")).take)
    recorded = {name.lower(): clip.values[:, i] for i, name in enumerate(clip.names)}
    weights = np.zeros((len(clip.values), len(rig.shapes)))
    for column, name in enumerate(rig.shapes):
        plain = channel_of(name)
        for key in (plain, plain.removesuffix("left").removesuffix("right")):
            if key in recorded:
                weights[:, column] = np.clip(recorded[key], 0, 1)
                break
    mesh = rig.meshes[0]
    chosen = _spread_markers(rig, mesh, markers)
    return _subject("ict_face, recorded curves", rig, mesh, weights[200:], frames, chosen)


def _subject(  # type: ignore[no-untyped-def]
    name: str, rig, mesh: RigMesh, weights: np.ndarray, frames: int, chosen: np.ndarray
) -> Subject:
    shapes = Deformer(rig).shapes
    rows = np.linspace(0, len(weights) - 1, frames).astype(int)
    size = len(mesh.points)
    motion = np.concatenate(
        [shapes.offsets(weights[part])[:, :size] for part in np.array_split(rows, 8)]
    )
    names = [shape.lower() for shape in rig.shapes]
    return Subject(
        name=name,
        points=mesh.points,
        counts=mesh.face_counts,
        indices=mesh.face_indices,
        chosen=chosen,
        places=places_at_points(mesh.face_counts, mesh.face_indices, chosen),
        motion=motion,
        offsets=sparse.csc_array(shapes.target_offsets())[:, : 3 * size],
        jaw=names.index("jawopen"),
        mouth=np.flatnonzero([n.startswith(("mouth", "jaw")) for n in names]),
    )


def _spread_markers(rig, mesh: RigMesh, count: int) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Choose distant points, more densely where the face moves more."""
    dense = Deformer(rig).shapes.target_offsets().toarray()
    energy = np.sqrt((dense.reshape(len(dense), -1, 3) ** 2).sum(axis=(0, 2)))[: len(mesh.points)]
    pool = np.flatnonzero(energy > 0.1 * energy.max())
    chosen, away = [pool[0]], np.full(len(pool), np.inf)
    importance = 0.5 + energy[pool] / energy.max()
    while len(chosen) < count:
        newest = np.linalg.norm(mesh.points[pool] - mesh.points[chosen[-1]], axis=1)
        away = np.minimum(away, newest)
        chosen.append(pool[int((away * importance).argmax())])
    return np.array(chosen)


def deviations_of_axes(fitted: GpSurface, moved: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each axis, (frames, points, 3), of which `sd` is the RMS."""
    theta, factors = fitted._sample(moved), fitted.factors
    chains = np.moveaxis(theta, 2, 3).reshape(len(theta), 4, -1)
    moments = average_dual_weights(fitted.table.spectrum, _rows_of_axes(moved), chains)
    variance = np.maximum(predict_variance(fitted.basis, moments), fitted.least_variance)
    variance += moments.constant[:, None] * fitted.added
    variance = variance.reshape(-1, 3, fitted.point_count)
    deviations = np.sqrt(variance) * factors.of_axes[:, None] * factors.of_points
    if fitted.shared is not None:
        measured = np.ones(moved.shape[:2], bool)
        deviations *= frame_factors(moved, fitted.precision, measured)[:, None, None]
    return np.asarray(deviations.transpose(0, 2, 1))
