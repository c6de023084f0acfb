"""A rig's meshes as one deformable surface."""

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.assets import Rig, point_slices, range_ends
from usdface.numerics.registration.face_skin import FaceSkin, sample_face_skin
from usdface.numerics.solve.blendshapes import BlendShapes, ChannelKeys, Key
from usdface.numerics.surface.triangulation import triangulate


class Deformer:
    """All meshes of a rig with concatenated points, and their shapes.

    Attributes
    ----------
    neutral : (points, 3) float array
        Every mesh at rest [mm]; see `point_slices`.
    triangles : (triangles, 3) int array
        Of all meshes, counterclockwise seen from outside.
    shapes : BlendShapes
        Channels in the rig's order, then combinations.
    """

    def __init__(self, rig: Rig) -> None:
        counts = [len(mesh.points) for mesh in rig.meshes]
        places = list(zip(rig.meshes, point_slices(rig.meshes), strict=True))
        self.neutral: FloatArray = np.concatenate([mesh.points for mesh in rig.meshes])
        triangles = []  # outward
        for mesh, own in places:
            found = triangulate(mesh.face_counts, mesh.face_indices)[0] + own.start
            triangles.append(found[:, ::-1] if mesh.inside_out else found)
        self.triangles: IntArray = np.concatenate(triangles)
        skin = {mesh.path for mesh in rig.skin_meshes}
        self._is_skin = np.repeat([mesh.path in skin for mesh in rig.meshes], counts)
        self._ends = range_ends(rig.ranges)
        channels = index_of((*rig.shapes, *(each.shape for each in rig.combinations)))
        self.shapes = BlendShapes(
            len(self.neutral),
            len(rig.shapes),
            [
                ChannelKeys(
                    channels[shape.name],
                    [Key(key.weight, key.points + own.start, key.offsets) for key in shape.keys],
                )
                for mesh, own in places
                for shape in mesh.shapes
            ],
            logic=rig.logic if rig.combinations else None,
        )

    def points(self, weights: FloatArray) -> FloatArray:
        """Return the surface for each frame: (frames, points, 3) float array [mm]."""
        return self.neutral + self.shapes.offsets(weights)

    def face_skin(self) -> FaceSkin:
        """Sample the skin, of `skin_meshes`, that shapes move; `ValueError` if there is none."""
        return sample_face_skin(
            self.neutral,
            self.triangles[self._is_skin[self.triangles[:, 0]]],
            self.full_offsets().multiply(np.repeat(self._is_skin, 3)).tocsr(),
        )

    def full_offsets(self) -> sparse.csr_array:
        """Return displacements at the ends of ranges: (shapes, 3 * points) sparse array."""
        return sparse.csr_array(self.shapes.target_offsets().multiply(self._ends[:, None]))
