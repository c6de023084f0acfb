"""Faces in known motion, with the faults of meshes, for `random_surfaces`."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.performers import performance
from benchmarks.random_captures import channel_columns
from benchmarks.random_setups import bursts
from tests.conftest import SHARED_DATA
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.demo.sculpt import ACTOR, CHARACTER
from usdface.numerics.measure.performance_error import find_lip_pairs
from usdface.numerics.surface.surface_graph import connected_parts
from usdface.numerics.surface.triangulation import polygon_edges
from usdface.usdio.rig.read import read_rig

FRAMES = 32
DEMOS = {"actor": ACTOR, "character": CHARACTER}
OUTSIDE_MM = 3.0
"""Points less than this behind another that covers them are on the outside of the face."""


@dataclass(frozen=True)
class Face:
    """A mesh in motion [mm]; the first frame is at rest."""

    points: np.ndarray
    polygons: list[np.ndarray]
    motion: np.ndarray
    lids: np.ndarray
    """(points,): motion by blinks, relative to the largest."""
    lip: np.ndarray
    """(points,): 1 on the upper lip and -1 on the lower, where they touch."""
    outer: np.ndarray
    """(points,): whether it is seen from the front or the side."""

    def take(self, rows: np.ndarray, polygons: list[np.ndarray]) -> "Face":
        """Return a face with copies of points."""
        one = (self.points, self.lids, self.lip, self.outer)
        points, lids, lip, outer = (each[rows] for each in one)
        return Face(points, polygons, self.motion[:, rows], lids, lip, outer)


def make_face(setup: SimpleNamespace, rng: np.random.Generator) -> Face:
    """Return a drawn face in motion."""
    file = SHARED_DATA / "rigs" / f"{setup.face}.usdc"
    rig = demo_rig(DEMOS[setup.face]) if setup.face in DEMOS else read_rig(file)
    mesh, names = rig.meshes[0], [shape.lower() for shape in rig.shapes]
    size = len(mesh.points)
    offsets = sparse.csr_array(Deformer(rig).shapes.target_offsets().tocsc()[:, : 3 * size])
    values, channels = performance("livelink_alex/alex_rom_3.csv", 30)
    start, step = int(rng.integers(500, len(values) - 2600)), 2400 // FRAMES
    rows = values[start : start + step * FRAMES : step].copy()
    if setup.acted == "bursts":
        rows = bursts(channels, rng, step * FRAMES)[::step]
    if setup.acted == "jaw":
        rows[:, channels.index("jawopen")] = rng.random(FRAMES)
    if setup.acted == "winks":
        rows[:, [channel.endswith("right") for channel in channels]] *= 0.1
        rows[:, channels.index("eyeblinkleft")] = rng.random(FRAMES)
    weights = np.zeros((FRAMES, len(names)))
    for column, channel in channel_columns(rig.shapes, channels):
        weights[1:, column] = rows[1:, channel]
    mouth = np.flatnonzero([name.startswith(("mouth", "jaw")) for name in names])
    lips = find_lip_pairs(mesh.points, offsets, jaw_open=names.index("jawopen"), mouth=mouth)
    lip, blinks = np.zeros(size), [i for i, name in enumerate(names) if "blink" in name]
    if lips is not None:
        lip[lips.upper], lip[lips.lower] = 1, -1
    blink = np.linalg.norm(offsets[blinks].toarray().reshape(-1, size, 3), axis=(0, 2))
    polygons = np.split(mesh.face_indices, np.cumsum(mesh.face_counts)[:-1])
    parts = connected_parts(polygon_edges(mesh.face_counts, mesh.face_indices), size)
    outer = np.zeros(size, bool)
    for degrees in (-60, 0, 60):
        x, y, z = (mesh.points @ Rotation.from_euler("y", degrees, degrees=True).as_matrix().T).T
        near = KDTree(np.stack([x, y], axis=1)).query_ball_point(np.stack([x, y], axis=1), 2.5)
        outer |= z > np.array([z[each].max() for each in near]) - OUTSIDE_MM
    outer &= parts == np.bincount(parts).argmax()
    motion = (weights @ offsets).reshape(FRAMES, size, 3)
    face = Face(mesh.points, polygons, motion, blink / blink.max(), lip, outer)
    return _damaged(face, setup.fault, rng)


def _damaged(face: Face, fault: str, rng: np.random.Generator) -> Face:
    size, polygons = len(face.points), [each.copy() for each in face.polygons]
    rows = np.arange(size)
    middle = np.array([face.points[each].mean(axis=0) for each in polygons])
    if fault == "triangles":
        polygons = [each[[0, i, i + 1]] for each in polygons for i in range(1, len(each) - 1)]
    if fault == "holes":
        away = np.asarray(KDTree(face.points[rng.integers(size, size=3)]).query(middle)[0])
        polygons = [each for each, far in zip(polygons, away > 10, strict=True) if far]
    if fault == "fins":  # edges with three faces, and faces without area
        chosen = rng.integers(len(polygons), size=40)
        polygons += [polygons[i][[0, 1, 2 - 2 * (k % 2)]] for k, i in enumerate(chosen)]
    if fault == "copies":  # which no face uses
        rows = np.concatenate([rows, rng.integers(size, size=size // 50)])
    if fault == "slivers":
        ends = np.array([polygons[i][:2] for i in rng.integers(len(polygons), size=size // 50)])
        ends = ends[face.lip[ends].sum(axis=1) == 0]
        near = replace(face, points=face.points.copy(), motion=face.motion.copy())
        for field in (near.points, *near.motion):
            field[ends[:, 0]] = 0.05 * field[ends[:, 0]] + 0.95 * field[ends[:, 1]]
        return near
    if fault == "soup":
        rows = np.concatenate(polygons)
        polygons = np.split(np.arange(len(rows)), np.cumsum([len(each) for each in polygons])[:-1])
    if fault == "seam":
        left = middle[:, 0] > rng.uniform(-30, 30)
        new = np.concatenate([rows, np.arange(size)])
        polygons = [each + size * side for each, side in zip(polygons, left, strict=True)]
        return face.take(new, polygons)
    return face.take(rows, polygons)
