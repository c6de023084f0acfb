"""Compose solve and edits into the weights that are published."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.text import first_few, pluralize
from usdface.numerics.motion.key_reduction import Deviation, reduce_keys
from usdface.runner.result import StepResult
from usdface.specs.edits import BakeSpec
from usdface.usdio.performance.edits import edited_weights
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import writing_weights
from usdface.usdio.rig.read import read_rig

_BLOCK_FRAMES = 4096
"""Frames that are composed at once; their ends are keys, so that memory stays bounded."""

SURFACE_FRAMES = 8
"""Frames whose surface is compared at once."""


def run(spec: BakeSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Write the edited weights as one layer of UsdSkel animation."""
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    file, prim = reader.rig()
    rig = read_rig(file, prim=prim)
    # A performance of before the rig had its logic lacks what is driven.
    lacking = tuple(each for each in rig.combinations if each.shape not in reader.names)
    header = replace(reader.header, combinations=lacking)
    kept = 0
    with writing_weights(spec.out, header, rig, provenance=provenance) as writer:
        surface = _Surface(rig, reader.names) if spec.unit == "mm" and spec.tolerance else None
        for first in range(reader.first_frame, reader.last_frame + 1, _BLOCK_FRAMES):
            last = min(first + _BLOCK_FRAMES - 1, reader.last_frame)
            weights = baked_weights(reader, rig, first, last, limit=spec.limit)
            keys = _keys(spec, weights, surface)
            kept += len(keys)
            writer.append(
                weights,
                uncertainty_mm=reader.uncertainty_mm(first, last),
                coverage=reader.series("face:coverage", first, last),
                residual_mm=reader.series("face:residual", first, last),
                keys=keys,
            )
            done = last - reader.first_frame + 1
            progress(done / header.frame_count, f"baked to frame {last}")
    notes = []
    unknown = sorted(set(reader.edits) - set(reader.names))
    if unknown:
        notes.append(f"edits of {first_few(unknown)} find no such shape and were left out")
    edited = len(set(reader.edits) & set(reader.names))
    summary = f"{pluralize(header.frame_count, 'frame')}, {pluralize(edited, 'shape')} edited"
    if spec.tolerance:
        summary += f", {pluralize(kept, 'key')} within {spec.tolerance:g} {spec.unit}"
    return StepResult(
        (spec.out,),
        summary,
        tuple(notes),
        {"frames": header.frame_count, "keys": kept, "edited_shapes": edited},
    )


def baked_weights(
    reader: PerformanceReader, rig: Rig, first: int, last: int, *, limit: bool = False
) -> FloatArray:
    """Return the edited weights of some frames, within the rig's ranges if so wanted."""
    if not limit:
        return reader.edited(first, last).astype(np.float64)
    part = slice(first - reader.first_frame, last + 1 - reader.first_frame)
    ranges = {
        name: (float(low), float(high))
        for name, (low, high) in zip(rig.shapes, rig.ranges, strict=True)
    }
    edits = {name: edit.during(part) for name, edit in reader.edits.items()}
    return edited_weights(
        reader.names,
        reader.solved(first, last),
        edits,
        ranges=ranges,
        combinations=rig.combinations,
    )


def _keys(spec: BakeSpec, weights: FloatArray, surface: "_Surface | None") -> IntArray:
    if spec.tolerance is None:
        return np.arange(len(weights), dtype=np.int64)
    deviation = None if surface is None else surface.deviation(weights, spec.tolerance)
    return reduce_keys(weights, spec.tolerance, deviation=deviation)


class _Surface:
    """How far weights move a face, to know when a line between keys is near enough."""

    def __init__(self, rig: Rig, names: tuple[str, ...]) -> None:
        self._deformer = Deformer(rig)
        place = index_of(names)
        # Column -1 is one of zeros, for shapes of the rig that the performance does not drive.
        self._columns = np.array([place.get(name, -1) for name in rig.shapes])
        self._reach = np.zeros(len(names))  # mm per unit of weight, of the point that moves most
        for channel, name in enumerate(rig.shapes):
            if name in place:
                self._reach[place[name]] = self._steepest(rig, channel)

    def _steepest(self, rig: Rig, channel: int) -> float:
        name = rig.shapes[channel]
        keys = {
            key.weight
            for mesh in rig.meshes
            for shape in mesh.shapes
            if shape.name == name
            for key in shape.keys
        }
        knots = np.array(sorted(keys | {0.0}))
        weights = np.zeros((len(knots), len(rig.shapes)))
        weights[:, channel] = knots
        moved = np.linalg.norm(np.diff(self._deformer.points(weights), axis=0), axis=2).max(axis=1)
        return float((moved / np.diff(knots)).max())

    def deviation(self, true: FloatArray, tolerance: float) -> Deviation:
        """Return the measure that `reduce_keys` asks for."""

        def measure(part: slice, weights: FloatArray) -> FloatArray:
            # No point moves further than all shapes together can move one: often that is enough.
            far = np.abs(weights - true[part]) @ self._reach
            doubtful = np.flatnonzero(far > tolerance)
            doubtful = doubtful[np.argsort(-far[doubtful], kind="stable")]
            far = np.minimum(far, tolerance)
            for start in range(0, len(doubtful), SURFACE_FRAMES):
                rows = doubtful[start : start + SURFACE_FRAMES]
                apart = self._points(weights[rows]) - self._points(true[part][rows])
                far[rows] = np.linalg.norm(apart, axis=2).max(axis=1)
                if far[rows].max() > tolerance:
                    break  # there is a key to set; the other frames are looked at again after it
            return far

        return measure

    def _points(self, weights: FloatArray) -> FloatArray:
        padded = np.concatenate([weights, np.zeros((len(weights), 1))], axis=1)
        return self._deformer.points(padded[:, self._columns])
