"""Authored normals of a rig and the ``normalOffsets`` of its shapes.

Pictures use normals of the posed surface, plus corrections: authored normals minus those of the
surface at rest, and for each key with normal offsets, the offsets minus the change of the surface's
normals at that key. The result equals UsdSkel's at rest and at each key; between keys, and for
shapes without normal offsets, normals follow the surface.
"""

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray, coordinates_of
from usdface.core.assets import Rig, RigMesh, point_slices
from usdface.core.deformer import Deformer
from usdface.numerics.surface.triangulation import normal_operator, triangulate, vertex_normals


class SculptedNormals:
    """Corrections of the surface's normals by a rig's authored normals.

    Those of subdivided meshes are ignored: the limit surface has its own.
    """

    def __init__(self, rig: Rig, deformer: Deformer) -> None:
        self._shapes = deformer.shapes
        rest = [np.zeros(mesh.points.shape) for mesh in rig.meshes]
        rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
        row = 0
        for own, mesh, part in zip(rest, rig.meshes, point_slices(rig.meshes), strict=True):
            keys = [key for shape in mesh.shapes for key in shape.keys]
            first, row = row, row + len(keys)
            sculpted = mesh.normals is not None or any(k.normal_offsets is not None for k in keys)
            if mesh.subdivision != "none" or not sculpted or not len(mesh.face_counts):
                continue
            surface = _MeshSurface(mesh)
            if mesh.normals is not None:
                own[:] = surface.sign * mesh.normals - surface.rest
            for number, key in enumerate(keys):
                if key.normal_offsets is None:
                    continue
                beyond = surface.rest - surface.moved(key.points, key.offsets)
                beyond[key.points] += surface.sign * key.normal_offsets
                at = np.flatnonzero(np.abs(beyond).max(axis=1) > 1e-9)
                columns.append(coordinates_of(part.start + at))
                rows.append(np.full(3 * len(at), first + number))
                values.append(beyond[at].ravel())
        self._rest = np.concatenate(rest)
        places = np.concatenate(rows), np.concatenate(columns)
        self._keys = sparse.csr_array((np.concatenate(values), places), (row, self._rest.size))
        self.any = bool(self._keys.nnz or self._rest.any())
        """Whether any correction is not zero."""

    def at(self, weights: FloatArray) -> FloatArray | None:
        """Return the correction of unit normals at weights, (shapes,); None if there is none.

        (points, 3), in the direction of each mesh's winding.
        """
        if not self.any:
            return None
        moved = self._shapes.key_weights(weights[None]) @ self._keys
        return np.asarray(self._rest + np.asarray(moved).reshape(self._rest.shape), np.float64)


class _MeshSurface:
    """Normals of a mesh's surface, at rest and posed."""

    def __init__(self, mesh: RigMesh) -> None:
        self._mesh = mesh
        self._triangles, _ = triangulate(mesh.face_counts, mesh.face_indices)
        self._operator = normal_operator(self._triangles, point_count=len(mesh.points))
        self.rest: FloatArray = self._normals(mesh.points)
        # Authored normals of left-handed meshes oppose the winding.
        aligned = 1.0 if mesh.normals is None else float(np.sum(self.rest * mesh.normals))
        self.sign = -1.0 if aligned < 0 else 1.0

    def moved(self, points: IntArray, offsets: FloatArray) -> FloatArray:
        """Return unit normals with offsets added to some points."""
        posed = self._mesh.points.copy()
        posed[points] += offsets
        return self._normals(posed)

    def _normals(self, points: FloatArray) -> FloatArray:
        return vertex_normals(points, self._triangles, self._operator)
