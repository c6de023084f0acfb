"""Compose solve and edits into the layer of weights to publish."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import first_few, pluralize
from usdface.numerics.motion.key_reduction import Deviation, reduce_keys
from usdface.runner.result import StepResult
from usdface.specs.edits import BakeSpec
from usdface.usdio.authoring import text_of
from usdface.usdio.performance.driving_layers import DRIVING_PATHS, opened_driving_layer
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import VARIANT_SET, writing_weights
from usdface.usdio.rig.reference import read_rig_of_stage

_BLOCK_FRAMES = 4096
"""Frames per block, to bound memory; keys are reduced within blocks."""

SURFACE_FRAMES = 8
"""Frames per comparison of surfaces, to bound memory."""


def run(spec: BakeSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Write the edited weights as one layer of UsdSkel animation."""
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    rig = read_rig_of_stage(reader.stage, reader.animation)
    # Performances made before the rig had its logic lack the driven shapes.
    missing = tuple(each for each in rig.combinations if each.shape not in reader.names)
    header = replace(reader.header, combinations=missing)
    kept = 0
    ranges = dict(zip(rig.shapes, rig.ranges.tolist(), strict=True)) if spec.limit else None
    with writing_weights(spec.out, header, rig, provenance=provenance) as writer:
        surface = _Surface(rig, reader.names) if spec.unit == "mm" and spec.tolerance else None
        for first in range(reader.first_frame, reader.last_frame + 1, _BLOCK_FRAMES):
            last = min(first + _BLOCK_FRAMES - 1, reader.last_frame)
            weights = reader.edited(first, last, ranges=ranges).astype(np.float64)
            keys = _keys(spec, weights, surface)
            kept += len(keys)
            writer.append(weights, reader.figures(first, last), keys=keys)
            done = last - reader.first_frame + 1
            progress(done / header.frame_count, f"baked to frame {last}")
    notes = [*_left_out(reader), *driving_notes(reader)]
    unknown = sorted(set(reader.edits) - set(reader.names))
    if unknown:
        notes.append(
            f"edits of shapes that the performance lacks were left out: {first_few(unknown)}"
        )
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


def driving_notes(reader: PerformanceReader) -> list[str]:
    """Return notes on the layers of joints and attributes, which a layer of weights lacks."""
    layers = (opened_driving_layer(reader, each) for each in DRIVING_PATHS)
    return [
        f"only weights are baked: {Path(found[0].layer.realPath).name} moves joints or attributes; "
        "sublayer it as well"
        for found in layers
        if found is not None
    ]


def _left_out(reader: PerformanceReader) -> list[str]:
    """Return notes on what is left out: other takes; at another rate, timecode and samples."""
    notes = []
    above = map(reader.stage.GetPrimAtPath, reader.animation.GetPath().GetPrefixes())
    for takes in (prim.GetVariantSet(VARIANT_SET) for prim in above):
        if len(others := takes.GetVariantNames()) > 1:
            notes.append(
                f"of the takes {first_few(others)}, only {takes.GetVariantSelection()} is used, "
                "which the layer shows; give the performance of another by itself"
            )
    if not reader.timecode_fits and text_of(reader.animation, "face:timecode:start"):
        notes.append(
            f"the timecode of the capture has no labels at {float(reader.rate):g} frames per "
            "second, and was left out"
        )
    between = reader.between_frames
    if between.any():
        notes.append(
            f"{between.sum()} of {pluralize(len(between), 'sample')} lie between the frames of "
            f"{reader.path.name}, {float(reader.rate):g} per second: left out, weights at frames "
            "are interpolated; to keep them, author the capture's timeCodesPerSecond in that layer"
        )
    return notes


def _keys(spec: BakeSpec, weights: FloatArray, surface: "_Surface | None") -> IntArray:
    if spec.tolerance is None:
        return np.arange(len(weights), dtype=np.int64)
    deviation = None if surface is None else surface.deviation(weights, spec.tolerance)
    return reduce_keys(weights, spec.tolerance, deviation=deviation)


class _Surface:
    """Deviation of the surface between two sets of weights."""

    def __init__(self, rig: Rig, names: tuple[str, ...]) -> None:
        self._deformer = Deformer(rig)
        place = index_of(names)
        # Column -1 is zero, for shapes of the rig that the performance lacks.
        self._columns = np.array([place.get(name, -1) for name in rig.shapes])
        self._reach = np.zeros(len(names))  # largest mm per unit of weight, over points
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
        """Return the measure of deviation for `reduce_keys` [mm]."""

        def measure(part: slice, weights: FloatArray) -> FloatArray:
            # The sum of the shapes' largest displacements is a bound, and often sufficient.
            deviation = np.abs(weights - true[part]) @ self._reach
            beyond = np.flatnonzero(deviation > tolerance)
            beyond = beyond[np.argsort(-deviation[beyond], kind="stable")]
            deviation = np.minimum(deviation, tolerance)
            for start in range(0, len(beyond), SURFACE_FRAMES):
                rows = beyond[start : start + SURFACE_FRAMES]
                difference = self._points(weights[rows]) - self._points(true[part][rows])
                deviation[rows] = np.linalg.norm(difference, axis=2).max(axis=1)
                if deviation[rows].max() > tolerance:
                    break  # a key is set there, and the other frames are measured again
            return deviation

        return measure

    def _points(self, weights: FloatArray) -> FloatArray:
        padded = np.concatenate([weights, np.zeros((len(weights), 1))], axis=1)
        return self._deformer.points(padded[:, self._columns])
