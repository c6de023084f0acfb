"""Colours for a rig that has none: skin, eyes, teeth, and a dark inside of the mouth."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from usdface.assets import FloatArray, RigMesh
from usdface.media import shading
from usdface.media.mesh_topology import Sparse, polygon_edges
from usdface.media.parts import Part, Pieces

_CLOSED, _OPEN = 0.015, 0.09  # of the sky seen at rest: inside of a mouth below, skin above


def paint(meshes: Sequence[RigMesh], pieces: Pieces, *, exposure: FloatArray) -> FloatArray:
    """Return a colour for every point: the rig's own where it has them.

    Parameters
    ----------
    meshes : sequence of RigMesh
    pieces : Pieces
    exposure : (points,) float array
        How much of the sky each point sees, mouth shut [0-1].

    Returns
    -------
    (points, 3) float array
        Linear.
    """
    palette = np.zeros((len(Part), 3))
    palette[Part.SKIN], palette[Part.EYE] = shading.SKIN, shading.SCLERA
    palette[Part.TEETH], palette[Part.MOUTH] = shading.TEETH, shading.TONGUE
    palette[Part.HAIR] = shading.HAIR
    parts = pieces.parts[pieces.of_point]
    skin = parts == Part.SKIN
    links = _neighbours(meshes)
    smooth = _spread(exposure, links, times=2)
    inside = np.where(skin, _step((_OPEN - smooth) / (_OPEN - _CLOSED)), 0.0)
    colors = palette[parts]
    colors += (shading.INNER_MOUTH - colors) * inside[:, None]
    first = 0
    for mesh in meshes:
        if mesh.colors is not None:
            colors[first : first + len(mesh.points)] = mesh.colors
        first += len(mesh.points)
    return colors


def _step(value: FloatArray) -> FloatArray:
    """Climb smoothly from 0 to 1."""
    limited = np.clip(value, 0, 1)
    return np.asarray(limited**2 * (3 - 2 * limited))


def _neighbours(meshes: Sequence[RigMesh]) -> Sparse:
    """Return the symmetric (points, points) matrix that is 1 where an edge joins two points."""
    pairs, first = [], 0
    for mesh in meshes:
        pairs.append(polygon_edges(mesh.face_counts, mesh.face_indices) + first)
        first += len(mesh.points)
    rows, columns = np.concatenate(pairs).T
    ones = np.ones(len(rows))
    one_way = sparse.csr_array((ones, (rows, columns)), shape=(first, first))
    links = one_way + one_way.T
    links.data[:] = 1.0
    return links


def _spread(values: FloatArray, links: Sparse, *, times: int) -> FloatArray:
    """Average each point with its neighbours: counting rays is noisy."""
    degree = np.maximum(np.asarray(links.sum(axis=1)).reshape(-1), 1)
    for _ in range(times):
        values = 0.5 * values + 0.5 * np.asarray(links @ values) / degree
    return values
