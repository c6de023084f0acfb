"""Markers and weights from USD files of other tools: Points, Skeleton joints or Xforms."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from usdface.core.arrays import BoolArray, Float32Array, FloatArray
from usdface.core.assets import WeightsClip
from usdface.core.errors import InputError
from usdface.core.rates import check_frame_span, exact_rate
from usdface.usdio.authoring import names_in, prim_or_root, read_array_samples
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.edits import edited_frames
from usdface.usdio.units import column_matrix, stage_to_ours, transform_points

NAME_ATTRIBUTES = (
    "face:markers:names",
    "primvars:names",
    "primvars:markerNames",
    "primvars:labels",
    "primvars:name",
)
"""Attributes in which other tools store one label per point."""

FEWEST_XFORMS = 3
"""Fewest moving Xforms of a marker set; fewer are a camera or a prop."""


@dataclass(frozen=True)
class ForeignTake:
    """Markers and weights of a foreign USD file."""

    rate: Fraction
    first_frame: int
    kind: str
    """Kind of the markers, with their prim path; empty without markers."""
    names: tuple[str, ...]
    positions: Float32Array
    """(frames, markers, 3) [mm], Y up, in world space. Arbitrary where not visible."""
    visible: BoolArray
    """(frames, markers)"""
    source: WeightsClip | None


@refusing_wrong_types
def read_foreign_take(path: Path, *, prim: str | None = None) -> ForeignTake:
    """Read markers and weights from a USD file that is not a take of our schema.

    `prim`: the prim of the markers, or one above it, if the file has several sets.
    """
    stage = open_stage(path)
    top = prim_or_root(stage, prim, file=path, option="--prim")
    sets = [*_points_sets(top), *_joint_sets(top)] or [*_xform_sets(top)]
    if len(sets) > 1:
        places = ", ".join(f"<{each.path}> ({each.kind})" for each in sets)
        raise InputError(f"{path}: {len(sets)} sets of markers: {places}; name one with --prim")
    weights = _weights_prim(top, path)
    if not sets and weights is None:
        raise InputError(
            f"{path}: holds no markers (time-sampled Points, Skeleton joints or Xforms) and no "
            "blendShapeWeights; check that the file is the capture"
        )
    if not sets:
        times = UsdSkel.Animation(weights).GetBlendShapeWeightsAttr().GetTimeSamples()
        sets = [_MarkerSet("", "", (), times, lambda time: np.zeros((0, 3)))]
    (markers,), ours = sets, stage_to_ours(stage)
    rate, first_frame, stage_times, sampled = _frame_grid(stage, markers.times, path)
    names, kind = markers.names, markers.kind and f"{markers.kind} <{markers.path}>"
    positions = np.empty((len(stage_times), len(names), 3), dtype=np.float32)
    for index, time in enumerate(stage_times):
        row = markers.at(time)
        if len(row) != len(names):
            raise InputError(
                f"{path} <{markers.path}> time code {time:g}: {len(row)} points for "
                f"{len(names)} markers; every marker must keep its slot over the take"
            )
        positions[index] = row @ ours.T
    visible = sampled[:, None] & np.isfinite(positions).all(axis=2)
    source = None
    if weights is not None:
        animation = UsdSkel.Animation(weights)
        channels = names_in(animation.GetBlendShapesAttr())
        attribute = animation.GetBlendShapeWeightsAttr()
        times, remedy = stage_times.tolist(), "export the animation again"
        values = read_array_samples(
            path, attribute, times, channels, kind=np.float32, remedy=remedy
        )
        source = WeightsClip(channels, values, first_frame, rate)
    return ForeignTake(rate, first_frame, kind, names, positions, visible, source)


def _frame_grid(
    stage: Usd.Stage, times: list[float], path: Path
) -> tuple[Fraction, int, FloatArray, BoolArray]:
    """Return rate and first frame of samples, and the time code of each frame and if it has one.

    The median spacing is one frame, and missing ones are gaps.
    """
    at = np.array(sorted(times))
    if len(at) < 2:
        raise InputError(f"{path}: {len(at)} time samples; a take needs at least two frames")
    check_frame_span(f"{path}: time samples", times[0], times[-1], samples=None)
    spacing = float(np.median(np.diff(at)))
    per_second = stage.GetTimeCodesPerSecond()
    if not (per_second > 0 and spacing > 0):
        raise InputError(
            f"{path}: timeCodesPerSecond {per_second:g} and a sample every {spacing:g} time codes "
            "give no rate; author timeCodesPerSecond"
        )
    first, last = (float(end) / spacing for end in (at[0], at[-1]))
    check_frame_span(f"{path}: time samples", first, last, samples=len(at))
    # One by one, as times may be rounded.
    steps = np.cumsum([0, *np.round(np.diff(at) / spacing)]).astype(np.int64)
    spacing = float(at[-1] - at[0]) / int(steps[-1])
    uneven = np.abs(at - at[0] - steps * spacing).max() > 0.25 * spacing
    if uneven or (np.diff(steps) < 1).any():
        raise InputError(
            f"{path}: samples are not evenly spaced (usually {spacing:g} time codes apart); "
            "resample the capture to whole frames"
        )
    sampled = np.zeros(steps[-1] + 1, dtype=np.bool_)
    sampled[steps] = True
    rate = exact_rate(per_second / spacing, where=f"{path}: sample spacing")
    frame_times = at[0] + spacing * np.arange(len(sampled))
    frame_times[steps] = at  # a hair beside a sample, USD interpolates with the next, perhaps NaN
    return rate, round(at[0] / spacing), frame_times, sampled


@dataclass(frozen=True)
class _MarkerSet:
    """Markers of one kind at one prim."""

    kind: str
    path: str
    names: tuple[str, ...]
    times: list[float]
    at: Callable[[float], FloatArray]
    """Positions at a time code, (markers, 3), in world space and the stage's units; NaN in gaps."""


def _points_sets(top: Usd.Prim) -> Iterator[_MarkerSet]:
    for prim in Usd.PrimRange(top):
        attribute = UsdGeom.Points(prim).GetPointsAttr() if prim.IsA(UsdGeom.Points) else None
        if attribute and attribute.GetNumTimeSamples():
            yield _points_set(prim, attribute)


def _points_set(prim: Usd.Prim, attribute: Usd.Attribute) -> _MarkerSet:
    times, ids = attribute.GetTimeSamples(), UsdGeom.Points(prim).GetIdsAttr()
    slots = dict[int, int]()  # of each id, where points come and go or change their order
    for time in ids.GetTimeSamples():
        for each in ids.Get(time):
            slots.setdefault(each, len(slots))

    def at(time: float) -> FloatArray:
        points = np.array(attribute.Get(time) or [], dtype=np.float64).reshape(-1, 3)
        points[~np.isfinite(points)] = np.nan
        if slots and len(ids.Get(time)) == len(points):
            found, points = points, np.full((len(slots), 3), np.nan)
            points[[slots[each] for each in ids.Get(time)]] = found
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
        return transform_points(column_matrix(world), points)

    names = _labels(prim, tuple(slots) or range(len(attribute.Get(times[0]) or ())))
    return _MarkerSet("Points", str(prim.GetPath()), names, times, at)


def _labels(prim: Usd.Prim, numbers: Sequence[int]) -> tuple[str, ...]:
    first = Usd.TimeCode.EarliestTime()
    for name in NAME_ATTRIBUTES:
        if not (attribute := prim.GetAttribute(name)):
            continue
        primvar = UsdGeom.Primvar(attribute)  # may be indexed, as Houdini's
        value = primvar.ComputeFlattened(first) if primvar else attribute.Get(first)
        if value is not None and len(value) == len(numbers):
            return tuple(map(str, value))
    ids = UsdGeom.Points(prim).GetIdsAttr().Get()
    numbers = ids if ids is not None and len(ids) == len(numbers) else numbers
    return tuple(f"marker_{number:03d}" for number in numbers)


def _joint_sets(top: Usd.Prim) -> Iterator[_MarkerSet]:
    cache = UsdSkel.Cache()
    for prim in Usd.PrimRange(top):
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
    for prim in Usd.PrimRange(top):
        if not prim.IsA(UsdSkel.Skeleton):
            continue
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        animation = query.GetAnimQuery() if query else None
        times = animation.GetJointTransformTimeSamples() if animation else None
        if times:
            yield _joint_set(prim, query, list(times))


def _joint_set(skeleton: Usd.Prim, query: UsdSkel.SkeletonQuery, times: list[float]) -> _MarkerSet:
    joints = [str(joint) for joint in query.GetJointOrder()]
    # Markers are the leaves; joints above only group them.
    parents = {joint.rpartition("/")[0] for joint in joints}
    leaves = [index for index, joint in enumerate(joints) if joint not in parents]
    short = [joints[index].rpartition("/")[2] for index in leaves]
    full = [joints[index] for index in leaves]
    names = tuple(short if len(set(short)) == len(short) else full)

    def at(time: float) -> FloatArray:
        matrices = query.ComputeJointWorldTransforms(UsdGeom.XformCache(time))
        return _origins(matrices[index] for index in leaves)

    return _MarkerSet("Skeleton joints", str(skeleton.GetPath()), names, times, at)


def _xform_sets(top: Usd.Prim) -> Iterator[_MarkerSet]:
    for parent in Usd.PrimRange(top):
        moving = [
            child
            for child in parent.GetChildren()
            if child.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(child).GetTimeSamples()
        ]
        if len(moving) >= FEWEST_XFORMS:
            yield _xform_set(parent, moving)


def _xform_set(parent: Usd.Prim, prims: list[Usd.Prim]) -> _MarkerSet:
    sampled = [set(UsdGeom.Xformable(prim).GetTimeSamples()) for prim in prims]
    times = set[float]().union(*sampled)

    def at(time: float) -> FloatArray:
        cache = UsdGeom.XformCache(time)
        places = _origins(cache.GetLocalToWorldTransform(prim) for prim in prims)
        for row, (prim, own) in enumerate(zip(prims, sampled, strict=True)):
            visibility = UsdGeom.Imageable(prim).ComputeVisibility(time)
            if (len(own) > 1 and time not in own) or visibility == UsdGeom.Tokens.invisible:
                places[row] = np.nan  # not measured at this time
        return places

    names = tuple(prim.GetName() for prim in prims)
    return _MarkerSet("Xforms", str(parent.GetPath()), names, sorted(times), at)


def _origins(matrices: Iterable[Gf.Matrix4d]) -> FloatArray:
    """Return the translation of each matrix: (n, 3)."""
    places = [matrix.ExtractTranslation() for matrix in matrices]
    return np.array(places, dtype=np.float64).reshape(-1, 3)


def _weights_prim(top: Usd.Prim, path: Path) -> Usd.Prim | None:
    animations = [
        prim
        for prim in Usd.PrimRange(top)
        if prim.IsA(UsdSkel.Animation)
        and UsdSkel.Animation(prim).GetBlendShapeWeightsAttr().GetNumTimeSamples() > 1
    ]
    if len(animations) > 1:
        places = ", ".join(f"<{prim.GetPath()}>" for prim in animations)
        raise InputError(
            f"{path}: {len(animations)} animations with blendShapeWeights: {places}; name one, or "
            "a prim above it and its markers, with --prim"
        )
    if animations and edited_frames(animations[0]) is not None:
        raise InputError(
            f"{path} <{animations[0].GetPath()}>: has edits, which would be lost; ingest the layer "
            "that `usdface bake` writes of it"
        )
    return animations[0] if animations else None
