"""A rig's meshes as one deformable surface."""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.assets import Rig
from usdface.numerics.registration.face_skin import FaceSkin, sample_face_skin
from usdface.numerics.solve.blendshapes import BlendShapes, ChannelKeys, Key
from usdface.numerics.surface.triangulation import triangulate


class Deformer:
    """All meshes of a rig with concatenated points, and their shapes.

    Attributes
    ----------
    neutral : (points, 3) float array
        Every mesh at rest [mm].
    starts : (meshes + 1,) int array
        Mesh *i* owns the points ``starts[i]:starts[i + 1]``.
    triangles : (triangles, 3) int array
        Of all meshes.
    shapes : BlendShapes
        Channels in the rig's order, then combinations.
    """

    def __init__(self, rig: Rig) -> None:
        counts = [len(mesh.points) for mesh in rig.meshes]
        self.starts: IntArray = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.neutral: FloatArray = np.concatenate([mesh.points for mesh in rig.meshes])
        self.triangles: IntArray = np.concatenate(
            [
                triangulate(mesh.face_counts, mesh.face_indices)[0] + start
                for mesh, start in zip(rig.meshes, self.starts, strict=False)
            ]
        )
        channels = index_of((*rig.shapes, *(each.shape for each in rig.combinations)))
        self.shapes = BlendShapes(
            len(self.neutral),
            len(rig.shapes),
            [
                ChannelKeys(
                    channels[shape.name],
                    [Key(key.weight, key.points + start, key.offsets) for key in shape.keys],
                )
                for mesh, start in zip(rig.meshes, self.starts, strict=False)
                for shape in mesh.shapes
            ],
            logic=rig.logic if rig.combinations else None,
        )

    def points(self, weights: FloatArray) -> FloatArray:
        """Return the surface for each frame: (frames, points, 3) float array [mm]."""
        return self.neutral + self.shapes.offsets(weights)

    def face_skin(self) -> FaceSkin:
        """Sample the skin that the shapes move; `ValueError` if there is none."""
        return sample_face_skin(self.neutral, self.triangles, self.shapes.target_offsets())
