"""Extents of clouds of points."""

from collections.abc import Sequence

import numpy as np
from pxr import Sdf, UsdGeom, Vt

from usdface.core.arrays import Float32Array


class PointExtents:
    """Authors the widths and extents of a cloud of points.

    One width per point, since USD computes no extents with a constant width, and its validators
    compare them. Extents are per frame.
    """

    def __init__(self, prim: Sdf.PrimSpec, count: int, width: float) -> None:
        widths = Sdf.AttributeSpec(prim, "widths", Sdf.ValueTypeNames.FloatArray)
        widths.default = Vt.FloatArray(count, width)
        widths.SetInfo("interpolation", UsdGeom.Tokens.vertex)
        extent = Sdf.AttributeSpec(prim, "extent", Sdf.ValueTypeNames.Float3Array)
        self._path, self._radius = extent.path, np.float32(width) / np.float32(2)

    def author(self, layer: Sdf.Layer, frames: Sequence[int], points: Float32Array) -> None:
        """Write the extents of frames, whose points are (frames, points, 3) in stage units."""
        if not points.size:
            return
        columns = np.ascontiguousarray(points.transpose(0, 2, 1))  # seven times as fast
        ends = np.stack([columns.min(axis=2) - self._radius, columns.max(axis=2) + self._radius], 1)
        for frame, end in zip(frames, ends.astype(np.float32), strict=True):
            layer.SetTimeSample(self._path, frame, Vt.Vec3fArray.FromNumpy(end))
