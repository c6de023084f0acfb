"""Checks of timing and of weights over time."""

from collections.abc import Iterator

import numpy as np
from pxr import Usd, UsdSkel

from usdface.core.arrays import BoolArray, FloatArray, index_of, runs
from usdface.core.text import first_few, pluralize
from usdface.numerics.measure.face_regions import mirrored_shapes
from usdface.usdio.authoring import read_gaps, value_of
from usdface.usdio.checks.fault import Fault, Samples, is_recorded, is_solved, read_samples
from usdface.usdio.layers import usdface_data
from usdface.usdio.rig.read import RANGE_ATTRIBUTE, shape_prims
from usdface.usdio.rig.reference import rig_path_of


def check_timing(stage: Usd.Stage) -> Iterator[Fault]:
    """Check the timing of a stage with animated weights."""
    animated = [
        UsdSkel.Animation(prim).GetBlendShapeWeightsAttr()
        for prim in stage.TraverseAll()
        if prim.IsA(UsdSkel.Animation)
    ]
    animated = [each for each in animated if each and each.GetNumTimeSamples()]
    if not animated:
        return
    yield from _authored(stage)
    yield from _same_rate(stage)
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    has_range = stage.HasAuthoredTimeCodeRange()
    top = stage.GetRootLayer()
    is_ours = "usdface" in top.customLayerData
    for attribute in animated:
        times = np.array(attribute.GetTimeSamples())
        path = str(attribute.GetPath())
        # The range of a layer above is that of a cut, with samples on both sides.
        is_cut = not (is_ours or top.GetNumTimeSamplesForPath(attribute.GetPath()))
        beyond = times[0] < start or times[-1] > end
        if has_range and beyond and not (is_cut and times[0] <= end and times[-1] >= start):
            yield Fault.warning(
                path,
                f"samples from {times[0]:g} to {times[-1]:g} lie outside the stage's range, "
                f"{start:g} to {end:g}: a player would not show them; author startTimeCode "
                f"{times[0]:g} and endTimeCode {times[-1]:g}, "
                + (
                    "or move them into the range by a layer offset"
                    if is_cut
                    else "and cut in a layer above, which sublayers or references this one"
                ),
            )
        odd = times[np.abs(times - np.round(times)) > 1e-6]
        if len(odd):
            yield Fault.warning(
                path,
                f"{len(odd)} samples lie between time codes, the first at {odd[0]:g}: was the "
                "animation retimed by another layer's rate, or moved by a part of a frame? Author "
                "the same rate in both, and a whole layer offset",
            )


def _authored(stage: Usd.Stage) -> list[Fault]:
    layer = stage.GetRootLayer()
    return [
        Fault.error(
            "/",
            f"animated, but {name} is not authored: another root layer would rescale it; author "
            f"{name}",
        )
        for authored, name in (
            (layer.HasTimeCodesPerSecond(), "timeCodesPerSecond"),
            (layer.HasFramesPerSecond(), "framesPerSecond"),
            (layer.HasStartTimeCode(), "startTimeCode"),
            (layer.HasEndTimeCode(), "endTimeCode"),
        )
        if not authored
    ]


def _same_rate(stage: Usd.Stage) -> Iterator[Fault]:
    top = stage.GetRootLayer()
    if top.HasTimeCodesPerSecond() and top.HasFramesPerSecond():
        codes, frames = top.timeCodesPerSecond, top.framesPerSecond
        if codes != frames:
            yield Fault.warning(
                "/",
                f"{codes:g} time codes and {frames:g} frames per second: tools disagree on "
                "what a frame is then; author the same number",
            )
    for layer in stage.GetLayerStack(includeSessionLayers=False):
        rate = layer.timeCodesPerSecond
        if layer != top and layer.HasTimeCodesPerSecond() and rate != top.timeCodesPerSecond:
            yield Fault.warning(
                "/",
                f"{layer.GetDisplayName()} has {rate:g} time codes per second, "
                f"{top.GetDisplayName()} {top.timeCodesPerSecond:g}: USD moves its samples off "
                "the frames; author the rate of the capture in both",
            )


RANGE_TOLERANCE = 0.02
"""Tolerance of ranges, and of weights at 0 or at an end of the range: rounding and smoothing
overshoot a little."""

FASTEST_SECONDS = 0.02
"""Least time of a weight from 0 to 1 at its peak speed: the fastest blinks take 50 ms, and the peak
speed of a movement between rests is at most about twice its mean."""

FROZEN_SECONDS = 0.5
FROZEN_CHANGE = 1e-6
"""Duration, and largest change of a weight, of a frozen face; actors cannot hold so still."""

STUCK_SECONDS = 2.0
"""Longest time of a shape at one value, neither 0 nor an end of its range, while others move."""

MOTIONLESS_SECONDS = 10.0
"""Least length of takes in which constant shapes other than 0 are reported."""


def check_curves(prim: Usd.Prim) -> list[Fault]:
    """Find weights out of range, jumps, frozen stretches, motionless shapes and swapped sides."""
    if is_recorded(prim) or not is_solved(prim):
        return []
    samples = read_samples(prim)
    if samples is None:
        return []
    ranges = _ranges(prim, samples)
    found = _out_of_range(samples, ranges)
    if len(samples.times) > 2:
        # Gaps have a fault of their own.
        inside = np.zeros(len(samples.times), dtype=np.bool_)
        for first, last in read_gaps(prim):
            inside |= (samples.times >= first) & (samples.times <= last)
        captured = ~(inside[1:] | inside[:-1])
        found += [*_jumps(samples), *_frozen(samples, captured)]
        moving = np.ptp(samples.values, axis=0) > FROZEN_CHANGE
        by_pairs = _is_retargeted(prim)  # shapes that do not move are then at the pose of the pairs
        found += _stuck(samples, ranges, captured, among=moving | (not by_pairs))
        found += [*_motionless(samples, moving, by_pairs), *_side_swaps(samples)]
    return found


def pair_sides(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return (left, right) columns of shapes whose names differ only in the side."""
    partner = mirrored_shapes(names).tolist()
    # l precedes r, where two such names differ first.
    lowered = [name.lower() for name in names]
    return [(k, other) for k, other in enumerate(partner) if lowered[k] < lowered[other]]


def _ranges(prim: Usd.Prim, samples: Samples) -> FloatArray:
    """Return the ranges of the BlendShape prims, by default 0 to 1; without rig, of the samples."""
    names = samples.names
    if not prim.IsDefined():
        return np.stack([samples.values.min(axis=0), samples.values.max(axis=0)], axis=1)
    ranges = np.tile([0.0, 1.0], (len(names), 1))
    place = index_of(names)
    stage = prim.GetStage()
    for name, shape in shape_prims(stage.GetPrimAtPath(rig_path_of(stage, prim))):
        authored = value_of(shape, RANGE_ATTRIBUTE) if shape else None
        if name in place and authored is not None:
            ranges[place[name]] = list(authored)
    return ranges


def _out_of_range(samples: Samples, ranges: FloatArray) -> list[Fault]:
    below = ranges[:, 0] - samples.values
    beyond = np.maximum(below, samples.values - ranges[:, 1])
    columns = np.flatnonzero(beyond.max(axis=0) > RANGE_TOLERANCE)
    counts = (beyond > RANGE_TOLERANCE).sum(axis=0)
    return [
        samples.warning(
            f"time code {samples.times[row]:g}: {samples.names[column]} is "
            f"{samples.values[row, column]:.2f}, its range is {ranges[column, 0]:g} to "
            f"{ranges[column, 1]:g} ({pluralize(int(counts[column]), 'sample')}); author "
            "face:range on the BlendShape if the rig can do this, else bake with --limit"
        )
        for column in columns
        for row in [int(beyond[:, column].argmax())]
    ]


def _jumps(samples: Samples) -> Iterator[Fault]:
    """Find the fastest change of each shape that is faster than any face."""
    seconds = np.diff(samples.times) / samples.rate
    speed = np.abs(np.diff(samples.values, axis=0)) / seconds[:, None]
    # At film rates a blink takes a frame or two, which is no jump.
    too_fast = (speed > 1 / FASTEST_SECONDS) & (seconds[:, None] <= FASTEST_SECONDS)
    for column in np.flatnonzero(too_fast.any(axis=0)):
        row = int(np.where(too_fast[:, column], speed[:, column], 0).argmax())
        change = samples.values[row + 1, column] - samples.values[row, column]
        yield samples.warning(
            f"time code {samples.times[row + 1]:g}: {samples.names[column]} jumps by "
            f"{change:+.2f} in {1000 * seconds[row]:.0f} ms "
            f"({pluralize(int(too_fast[:, column].sum()), 'jump')}); look at the "
            "markers there, or fade the edit"
        )


def _frozen(samples: Samples, captured: BoolArray) -> list[Fault]:
    still = np.all(np.abs(np.diff(samples.values, axis=0)) <= FROZEN_CHANGE, axis=1)
    if still.all():
        return []  # a pose, not a performance
    return [
        samples.warning(
            f"time codes {first:g} to {last:g}: the face is frozen for {seconds:.1f} s; if it is "
            "no held pose, the capture was lost there: clean the take again, or cut"
        )
        for first, last, seconds in _stretches(samples, still & captured, FROZEN_SECONDS)
    ]


def _is_retargeted(prim: Usd.Prim) -> bool:
    stack = UsdSkel.Animation(prim).GetBlendShapeWeightsAttr().GetPropertyStack()
    return any(usdface_data(each.layer).get("step") in ("retarget", "warp") for each in stack)


def _stuck(
    samples: Samples, ranges: FloatArray, captured: BoolArray, *, among: BoolArray
) -> Iterator[Fault]:
    """Find the longest stretch of each shape at one value while others move."""
    still = np.abs(np.diff(samples.values, axis=0)) <= FROZEN_CHANGE
    moving = ~still.all(axis=1) & captured
    inside = np.minimum(samples.values - ranges[:, 0], ranges[:, 1] - samples.values)
    inside = np.minimum(inside, np.abs(samples.values))
    for column in np.flatnonzero(still.any(axis=0) & among):
        stuck: BoolArray = still[:, column] & moving & (inside[1:, column] > RANGE_TOLERANCE)
        stretches = _stretches(samples, stuck, STUCK_SECONDS)
        if stretches:
            first, last, seconds = max(stretches, key=lambda stretch: stretch[2])
            value = samples.values[np.searchsorted(samples.times, last), column]
            held = still[:, column] & (np.abs(samples.values[1:, column] - value) <= FROZEN_CHANGE)
            if len(_stretches(samples, held, FROZEN_SECONDS)) > 1:
                continue  # a pose to which it returns
            yield samples.warning(
                f"time codes {first:g} to {last:g}: {samples.names[column]} stays at "
                f"{value:.2f} for {seconds:.1f} s while the face moves; if no edit holds it, "
                "map again"
            )


def _stretches(
    samples: Samples, still: BoolArray, least_seconds: float
) -> list[tuple[float, float, float]]:
    """Return first and last time code, and seconds, of stretches that are long enough."""
    found = []
    for start, stop in runs(still):
        first, last = samples.times[start], samples.times[stop]
        seconds = (last - first) / samples.rate
        if seconds >= least_seconds and stop - start > 2:
            found.append((float(first), float(last), float(seconds)))
    return found


def _motionless(samples: Samples, moving: BoolArray, by_pairs: bool) -> list[Fault]:
    seconds = (samples.times[-1] - samples.times[0]) / samples.rate
    still = ~moving & (np.abs(samples.values[0]) > RANGE_TOLERANCE)  # 0: not in any reference
    if seconds < MOTIONLESS_SECONDS or not still.any() or not moving.any():
        return []
    motionless = [samples.names[column] for column in np.flatnonzero(still)]
    remedy = "tune references that show movement there, or leave such shapes out of the mapping"
    if by_pairs:
        remedy = "if the pairs do not hold them there on purpose, key pairs that move them"
    return [
        samples.warning(
            f"{pluralize(len(motionless), 'shape')} without any motion: {first_few(motionless)}; "
            f"{remedy}"
        )
    ]


def _side_swaps(samples: Samples) -> list[Fault]:
    """Find frames at which the weights of all left and right shapes are exchanged."""
    pairs = pair_sides(samples.names)
    if len(pairs) < 2:
        return []
    left = samples.values[:, [pair[0] for pair in pairs]].astype(np.float64)
    right = samples.values[:, [pair[1] for pair in pairs]].astype(np.float64)
    stays = np.linalg.norm(np.diff(np.hstack([left, right]), axis=0), axis=1)
    swaps = np.linalg.norm(np.hstack([left[1:] - right[:-1], right[1:] - left[:-1]]), axis=1)
    rows = np.flatnonzero((stays > 0.3) & (swaps < 0.3 * stays))
    if not len(rows):
        return []
    return [
        Fault.error(
            samples.path,
            f"time code {samples.times[rows[0] + 1]:g}: left and right shapes exchange their "
            f"weights ({len(rows)} times in all); look for swapped markers and clean again",
        )
    ]
