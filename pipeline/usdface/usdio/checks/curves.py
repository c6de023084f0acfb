"""Weights over time: in range, and moving as faces do."""

import numpy as np
from pxr import Usd, UsdSkel

from usdface.assets import FloatArray
from usdface.usdio.checks.fault import Fault, Samples, is_recorded, is_solved, read_samples, some

BEYOND = 0.02
"""How far outside its range a weight is let pass: rounding and smoothing overshoot a little."""

FASTEST_SECONDS = 0.033
"""No face makes a shape's whole way in less: a lid closes in 60 to 75 ms."""

FROZEN_SECONDS = 0.5
FROZEN_CHANGE = 1e-6
"""A face held by an actor still trembles; one that does not move at all for so long is not held."""

DEAD_SECONDS = 10.0
"""Only of a take this long can be said that a shape which never moved should have."""

SIDES = (("Left", "Right"), ("left", "right"), ("_L", "_R"), ("_l", "_r"), ("L_", "R_"))


def check_curves(prim: Usd.Prim) -> list[Fault]:
    """Look for weights out of range, jumps, frozen stretches, dead shapes, exchanged sides."""
    if is_recorded(prim) or not is_solved(prim):
        return []
    samples = read_samples(prim)
    if samples is None:
        return []
    found = _out_of_range(prim, samples)
    if len(samples.times) > 2:
        found += [*_jumps(samples), *_frozen(samples), *_dead(samples), *_exchanged(samples)]
    return found


def pair_sides(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return (left, right) columns of shapes that differ only in the side they name."""
    place = {name: index for index, name in enumerate(names)}
    pairs = []
    for name, index in place.items():
        for left, right in SIDES:
            other = place.get(name.replace(left, right)) if left in name else None
            if other is not None and other != index:
                pairs.append((index, other))
                break
    return pairs


def _ranges(prim: Usd.Prim, names: tuple[str, ...]) -> FloatArray:
    """Return what each shape's BlendShape prim allows; 0 to 1 where it says nothing."""
    ranges = np.tile([0.0, 1.0], (len(names), 1))
    place = {name: index for index, name in enumerate(names)}
    for mesh in prim.GetStage().Traverse():
        binding = UsdSkel.BindingAPI(mesh)
        own = binding.GetBlendShapesAttr().Get() or []
        targets = binding.GetBlendShapeTargetsRel().GetTargets() if own else []
        for name, target in zip(map(str, own), targets, strict=False):
            shape = prim.GetStage().GetPrimAtPath(target)
            told = shape.GetAttribute("face:range").Get() if shape else None
            if name in place and told is not None:
                ranges[place[name]] = list(told)
    return ranges


def _out_of_range(prim: Usd.Prim, samples: Samples) -> list[Fault]:
    ranges = _ranges(prim, samples.names)
    below = ranges[:, 0] - samples.values
    beyond = np.maximum(below, samples.values - ranges[:, 1])
    columns = np.flatnonzero(beyond.max(axis=0) > BEYOND)
    return [
        Fault(
            "warning",
            samples.path,
            f"time code {samples.times[row]:g}: {samples.names[column]} is "
            f"{samples.values[row, column]:.2f}, its range is {ranges[column, 0]:g} to "
            f"{ranges[column, 1]:g} ({int((beyond[:, column] > BEYOND).sum())} samples); bake with "
            "--limit, or author face:range on the BlendShape",
        )
        for column in columns
        for row in [int(beyond[:, column].argmax())]
    ]


def _jumps(samples: Samples) -> list[Fault]:
    """Find changes faster than any face; the worst of each shape is told."""
    seconds = np.diff(samples.times) / samples.rate
    speed = np.abs(np.diff(samples.values, axis=0)) / seconds[:, None]
    # At film rates a blink takes a frame or two: only what outruns even that is a jump.
    too_fast = (speed > 1 / FASTEST_SECONDS) & (seconds[:, None] <= FASTEST_SECONDS)
    found = []
    for column in np.flatnonzero(too_fast.any(axis=0)):
        row = int(np.where(too_fast[:, column], speed[:, column], 0).argmax())
        change = samples.values[row + 1, column] - samples.values[row, column]
        found.append(
            Fault(
                "warning",
                samples.path,
                f"time code {samples.times[row + 1]:g}: {samples.names[column]} jumps by "
                f"{change:+.2f} in {1000 * seconds[row]:.0f} ms "
                f"({int(too_fast[:, column].sum())} jumps); look at the markers there, or fade the "
                "edit",
            )
        )
    return found


def _frozen(samples: Samples) -> list[Fault]:
    still = (np.abs(np.diff(samples.values, axis=0)) <= FROZEN_CHANGE).all(axis=1)
    if still.all() or not still.any():
        return []  # a pose, not a performance; or nothing is frozen
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    found = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        seconds = (samples.times[stop] - samples.times[start]) / samples.rate
        if seconds >= FROZEN_SECONDS and stop - start > 2:
            found.append(
                Fault(
                    "warning",
                    samples.path,
                    f"time codes {samples.times[start]:g} to {samples.times[stop]:g}: the face is "
                    f"frozen for {seconds:.1f} s; was the capture lost there? Clean the take again "
                    "or cut",
                )
            )
    return found


def _dead(samples: Samples) -> list[Fault]:
    seconds = (samples.times[-1] - samples.times[0]) / samples.rate
    moving = np.ptp(samples.values, axis=0) > FROZEN_CHANGE
    if seconds < DEAD_SECONDS or moving.all() or not moving.any():
        return []
    dead = [name for name, moves in zip(samples.names, moving, strict=True) if not moves]
    return [
        Fault(
            "warning",
            samples.path,
            f"{len(dead)} shapes never move: {some(dead)}; tune references that show them, or "
            "leave them out of the mapping",
        )
    ]


def _exchanged(samples: Samples) -> list[Fault]:
    """Find where all left shapes take up what the right ones did, and the other way round."""
    pairs = pair_sides(samples.names)
    if len(pairs) < 2:
        return []
    left = samples.values[:, [pair[0] for pair in pairs]].astype(np.float64)
    right = samples.values[:, [pair[1] for pair in pairs]].astype(np.float64)
    stays = np.linalg.norm(np.diff(np.hstack([left, right]), axis=0), axis=1)
    swaps = np.linalg.norm(np.hstack([left[1:] - right[:-1], right[1:] - left[:-1]]), axis=1)
    rows = np.flatnonzero((stays > 0.3) & (swaps < 0.3 * stays))
    return (
        [
            Fault(
                "error",
                samples.path,
                f"time code {samples.times[rows[0] + 1]:g}: left and right shapes exchange their "
                f"weights ({len(rows)} times in all); look for swapped markers and clean again",
            )
        ]
        if len(rows)
        else []
    )
