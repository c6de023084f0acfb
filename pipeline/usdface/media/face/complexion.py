"""Default colours of a rig: skin, eyes, teeth, and a dark inside of the mouth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, smoothstep
from usdface.core.assets import RigMesh, point_slices
from usdface.media.face import shading
from usdface.media.face.features import ColorBand, find_bands
from usdface.media.face.parts import FacePart, Pieces
from usdface.numerics.surface.triangulation import Sparse, polygon_edges

_CLOSED, _OPEN = 0.015, 0.09  # visible share of the sky at rest: inside of a mouth, and skin


LEAST_OPACITY = 0.5
"""Faces below this opacity are not drawn: corneas and tear lines would hide eyes and lids."""

_PALE_LUMINANCE = 0.25  # linear green above which an eye of one colour has no iris


def tone(mesh: RigMesh) -> FloatArray | None:
    """Return the material colour of all opaque faces of a mesh; None if they differ."""
    if mesh.face_colors is None:
        return None
    opaque = mesh.face_colors[~(mesh.face_colors[:, 3] < LEAST_OPACITY), :3]
    if not len(opaque) or np.isnan(opaque).any() or np.ptp(opaque, axis=0).max() > 0:
        return None
    return np.asarray(opaque[0])


def faces_painted(mesh: RigMesh) -> FloatArray:
    """Return colours by face where materials differ within a mesh: (faces, 3); else NaN."""
    colors = np.full((len(mesh.face_counts), 3), np.nan)
    if mesh.face_colors is not None and tone(mesh) is None:
        colors[:] = mesh.face_colors[:, :3]
    return colors


def is_plain_eye(colors: FloatArray) -> bool:
    """Return whether an eye's colours, (n, 3), are absent or one pale colour: without an iris."""
    if not len(colors) or np.isnan(colors).all():
        return True
    one = np.ptp(colors, axis=0).max() < 0.02  # NaN compares false: partly painted is painted
    return bool(one and colors[0, 1] > _PALE_LUMINANCE)


@dataclass(frozen=True)
class Complexion:
    """The colours of a rig at rest."""

    colors: FloatArray
    """(points, 3): linear."""
    bands: tuple[ColorBand, ...]
    """Lips and brows, if the rig has no colours."""
    band_opacity: FloatArray
    """(points,): opacity of the bands at each point [0-1]."""


def colored_by_light(meshes: Sequence[RigMesh], pieces: Pieces) -> BoolArray:
    """Return which points have colours that depend on their exposure: (points,)."""
    own = [mesh.colors is None or tone(mesh) is not None for mesh in meshes]
    skin = pieces.parts[pieces.of_point] == FacePart.SKIN
    return np.asarray(skin & np.repeat(own, [len(mesh.points) for mesh in meshes]))


def paint(meshes: Sequence[RigMesh], pieces: Pieces, *, exposure: FloatArray) -> Complexion:
    """Return colours of all points: the rig's, or else those of its parts.

    `exposure`: (points,), visible share of the sky with the mouth shut [0-1]; any where the colours
    do not depend on it, see `colored_by_light`.
    """
    palette = np.zeros((len(FacePart), 3))
    palette[FacePart.SKIN], palette[FacePart.EYE] = shading.SKIN, shading.SCLERA
    palette[FacePart.TEETH], palette[FacePart.MOUTH] = shading.TEETH, shading.TONGUE
    palette[FacePart.HAIR] = shading.HAIR
    parts = pieces.parts[pieces.of_point]
    skin = parts == FacePart.SKIN
    links = _neighbours(meshes)
    degree = np.maximum(np.asarray(links.sum(axis=1)).reshape(-1), 1)
    smooth = exposure
    for _ in range(2):  # against the noise of ray counts
        smooth = 0.5 * smooth + 0.5 * np.asarray(links @ smooth) / degree
    inside = np.where(skin, smoothstep((_OPEN - smooth) / (_OPEN - _CLOSED)), 0.0)
    colors = palette[parts]
    bare = [mesh.colors is None and mesh.face_colors is None for mesh in meshes]
    plain = skin & np.repeat(bare, [len(mesh.points) for mesh in meshes])
    bands: tuple[ColorBand, ...] = ()
    if plain.any() and not np.any(parts == FacePart.HAIR):
        bands = find_bands(meshes, pieces.eyeballs.values(), plain)
    colors += (shading.INNER_MOUTH - colors) * inside[:, None]
    for mesh, own in zip(meshes, point_slices(meshes), strict=True):
        one = tone(mesh)
        if one is not None:  # for the mesh's largest part; teeth in a head of one material stay
            most = np.bincount(parts[own]).argmax() if len(parts[own]) else FacePart.SKIN
            toned = parts[own] == most
            shade = inside[own, None] * (most == FacePart.SKIN)
            mixed = one + (shading.INNER_MOUTH - one) * shade
            colors[own] = np.where(toned[:, None], mixed, colors[own])
        elif mesh.colors is not None:
            colors[own] = mesh.colors
    return Complexion(colors, bands, np.where(plain, 1 - inside, 0.0))


def _neighbours(meshes: Sequence[RigMesh]) -> Sparse:
    """Return the symmetric (points, points) adjacency matrix."""
    pairs = [
        polygon_edges(mesh.face_counts, mesh.face_indices) + own.start
        for mesh, own in zip(meshes, point_slices(meshes), strict=True)
    ]
    rows, columns = np.concatenate(pairs).T
    count = sum(len(mesh.points) for mesh in meshes)
    one_way = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    links = one_way + one_way.T
    links.data[:] = 1.0
    return links
