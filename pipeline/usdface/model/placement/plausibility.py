"""Plausibility of markers as those of a human face: size, speed, up axis, sides.

Impossible findings (a face of 20 mm: wrong unit) are distinguished from unusual ones (half an
adult's size: maybe a child). Labelled markers are compared with an adult's face; without labels
only the extent and motion of the cloud are checked.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, sample_frames
from usdface.core.assets import Markers
from usdface.core.errors import InputError
from usdface.model.placement.face_template import FaceFit, face_template, fit_face
from usdface.model.placement.label_hints import label_hint
from usdface.model.placement.skin_motion import SkinMotion

Aspect = Literal["size", "up", "sides", "part", "rate"]
"""Subject of a finding; each has an option of `ingest`."""

SIZE_LIMITS = (0.35, 2.0)
"""Possible size of a face relative to an adult's. Nasion to gnathion is about 55 mm in newborns and
115 with a standard deviation of 6 in adults (Farkas 1994, Anthropometry of the Head and Face): 0.48
to 1.15, widened for markers off their landmarks. Outside `SIZE_RANGE` it is unusual. A unit wrong
by 2.54 or 10 is outside the limits."""
SIZE_RANGE = (0.55, 1.5)

EXTENT_LIMITS_MM = (40.0, 2600.0)
"""Possible largest distance between two markers: a toddler's mouth is 35 mm wide, a body with
raised arms at most 2.6 m high."""
HEAD_MM = 450.0
"""Largest distance on one head: 260 mm from chin to crown at the 99th percentile (Young 1993, FAA
AM-93-10), plus markers of a cap and a collar."""

SPEED_LIMIT_MM_S = 400.0
"""Largest possible 99th percentile of marker speeds relative to the skull: the closing lid, the
fastest skin, reaches 170 to 200 mm/s, rarely 400 (Doane 1980, Am J Ophthalmol 89: 507-516). Above
`SPEED_RANGE_MM_S` it is unusual."""
SPEED_RANGE_MM_S = 200.0
RATE_RANGE = (15.0, 1000.0)
"""Usual frame rates [Hz]: slower cameras miss blinks, which last 0.1 to 0.2 s."""

LYING_DEGREES = 60.0
"""Mean angle between the head's up direction and the take's above which the axis is wrong: necks
bend by 45 to 55 at most (American Academy of Orthopaedic Surgeons, range of motion), a wrong axis
is off by 90 or 180."""
TILTED_DEGREES = 45.0

_MEASURED_ASPECTS: frozenset[Aspect] = frozenset({"size", "up", "rate"})
"""Aspects that an option states as a value, which may be wrong; the others it only permits."""

_FEWEST_LABELLED = 8
_LEAST_EXPLAINED = 0.6
"""Share of the markers' variance below which the template is not used: labels were misread."""
_MIRRORED_RATIO = 1.5
"""Ratio of residual squares, template over its mirror image, from which sides are exchanged."""
_FEWEST_MIRRORED = 12
"""Fewest markers for which that is certain: 36 coordinates give a likelihood ratio of 1.5^18."""
_BODY = re.compile(
    r"[lr]?(?:asi|psi|ster|clav|scap|acro|xiph|elb|wri|arm|kne|ank|toe|heel|thi|tib|sho|pelv|"
    r"shank|foot|fem|hip|fin|[ct]\d+$)",
    re.IGNORECASE,
)
"""Abbreviated parts of the body in marker sets such as Plug-in Gait."""
_BODY_SHARE = 0.2
_SAMPLE_FRAMES = 64

_UPPER = {"forehead", "brow", "lid", "eye", "eye corner"}
"""Without the bridge of the nose, which moves with the skull and shows no expression."""
_LOWER = {"mouth", "chin", "jaw"}
_FEWEST_OF_A_PART = 4

_ONE_FACE = "if they are of several people or a whole body, export those of one face alone"

_UNIT_SLIPS = {
    10.0: ("cm", "centimetres read as millimetres"),
    25.4: ("in", "inches read as millimetres"),
    1000.0: ("m", "metres read as millimetres"),
    2.54: ("in", "inches read as centimetres"),
    100.0: ("m", "metres read as centimetres"),
    0.1: ("mm", "millimetres read as centimetres"),
    1 / 25.4: ("mm", "millimetres read as inches"),
    1 / 2.54: ("cm", "centimetres read as inches"),
    0.01: ("cm", "centimetres read as metres"),
    0.001: ("mm", "millimetres read as metres"),
}
_NEAR_SLIP = 1.6
"""Tolerance as a factor; neighbouring factors of `_UNIT_SLIPS` differ by 2.5."""


@dataclass(frozen=True)
class PlausibilityFinding:
    """An implausible property of a take."""

    aspect: Aspect
    impossible: bool
    """True if no human face can have it; False if it is unusual."""
    message: str
    remedy: str
    """What to do about it, with the option of `ingest`."""


def judge_markers(
    markers: Markers, rate: float | None, *, axes: FloatArray | None = None
) -> tuple[PlausibilityFinding, ...]:
    """Return implausible properties of a take's markers.

    Parameters
    ----------
    markers : Markers
        Captured or stabilised; the up axis is checked best as captured.
    rate : float or None
        Frames per second; None if frames are not consecutive, and speeds are not checked.
    axes : (3, 3) float array, optional
        Rotation that brought the file's axes to Y up; names the axis in the remedy.
    """
    usable = markers.usable
    counts = usable.sum(axis=1)
    rows = np.flatnonzero(counts >= max(3, counts.max(initial=0) / 2))
    if not len(rows):
        return ()
    chosen = rows[sample_frames(len(rows), _SAMPLE_FRAMES)]
    positions, seen = markers.positions[chosen].astype(np.float64), usable[chosen]
    fits = _fits(markers.names, positions, seen)
    found = list(_part(markers.names, seen))
    face = face_template(markers.names).columns if fits else np.arange(len(markers.names))
    motion = SkinMotion.of(markers.positions[:, face], usable[:, face], rows, rate or 0.0)
    if fits:
        found += [*_labelled_size(fits), *_labelled_up(fits, axes), *_mirrored(fits)]
    of_body = sum(_BODY.match(label) is not None for label in markers.names)
    body = not fits and of_body > _BODY_SHARE * len(markers.names)
    head = bool(fits) or not (motion.articulated or body)
    if not (head or body):
        words = "the markers do not move as one head"
        found.append(PlausibilityFinding("part", False, words, _ONE_FACE))
    if head and not fits:
        found += [*_cloud_size(positions, seen), *_cloud_up(motion, axes)]
    right_size = not any(each.aspect == "size" for each in found)
    if right_size and head and rate is not None:
        found += _speed(motion)
    if rate is not None and not RATE_RANGE[0] <= rate <= RATE_RANGE[1]:
        found.append(_rate_finding(f"{rate:g} frames per second", impossible=False))
    return tuple(found)


def check_findings(
    findings: Iterable[PlausibilityFinding],
    *,
    stated: Collection[str] = (),
    where: object,
    before_remedy: str = "",
) -> tuple[str, ...]:
    """Return unusual findings as notes with remedies; refuse impossible ones.

    Parameters
    ----------
    stated : collection of str
        Aspects that the user confirmed by an option.
    where : object
        File, for the message.
    before_remedy : str
        Text before a remedy, for commands without the options of `ingest`.
    """
    findings = list(findings)
    refused = [each for each in findings if each.impossible and each.aspect not in stated]
    if refused:
        raise InputError(
            "\n".join(f"{where}: {each.message}; {before_remedy}{each.remedy}" for each in refused)
        )
    return tuple(_note(each, each.aspect in stated, before_remedy) for each in findings)


def _note(finding: PlausibilityFinding, stated: bool, before_remedy: str) -> str:
    """Return a finding as a note; a statement that makes a face impossible may be a mistake."""
    if not stated:
        return f"{finding.message}; {before_remedy}{finding.remedy}"
    if finding.impossible and finding.aspect in _MEASURED_ASPECTS:
        return f"{finding.message}; if that is not meant, {finding.remedy}"
    return finding.message


def unit_remedy(size: float) -> str:
    """Return the option that corrects a size, with the likely confusion of units."""
    size = max(size, np.finfo(float).tiny)
    slip = min(_UNIT_SLIPS, key=lambda factor: abs(np.log(factor * size)))
    if abs(np.log(slip * size)) > np.log(_NEAR_SLIP):
        return "state the unit with --units, or a factor with --scale"
    unit, words = _UNIT_SLIPS[slip]
    return f"state the unit with --units {unit} ({words}?), or a factor with --scale"


def _fits(labels: Sequence[str], positions: FloatArray, seen: BoolArray) -> list[FaceFit]:
    """Return fits of the template to frames; none with too few, or wrongly read, labels."""
    template = face_template(labels)
    fits = []
    for frame, mask in zip(positions[:, template.columns], seen[:, template.columns], strict=True):
        places, at = template.places[mask], frame[mask]
        if (
            len(at) >= _FEWEST_LABELLED
            and np.ptp(places, axis=0).any()
            and np.ptp(at, axis=0).any()
        ):
            fits.append(fit_face(places, at, template.weights[mask]))
    if not fits:
        return []
    explained = np.median([max(fit.explained, fit.explained_mirrored) for fit in fits])
    return fits if explained >= _LEAST_EXPLAINED else []


def _labelled_size(fits: list[FaceFit]) -> Iterable[PlausibilityFinding]:
    size = float(np.median([fit.size for fit in fits]))
    if SIZE_RANGE[0] <= size <= SIZE_RANGE[1]:
        return
    yield PlausibilityFinding(
        "size",
        not SIZE_LIMITS[0] <= size <= SIZE_LIMITS[1],
        f"the face is {size:.3g} times the size of an adult's, by where the labelled parts lie "
        f"({SIZE_RANGE[0]:g} to {SIZE_RANGE[1]:g} are usual)",
        unit_remedy(size),
    )


def _cloud_size(positions: FloatArray, seen: BoolArray) -> Iterable[PlausibilityFinding]:
    from scipy.spatial.distance import pdist  # only when wanted: it takes half a second

    extents = [
        pdist(frame[mask][:: max(int(mask.sum()) // 500, 1)]).max()
        for frame, mask in zip(positions, seen, strict=True)
    ]
    extent = float(np.median(extents))
    low, high = EXTENT_LIMITS_MM
    if low <= extent <= HEAD_MM:
        return
    yield PlausibilityFinding(
        "size",
        not low <= extent <= high,
        f"the markers span {extent:.4g} mm, and those of a head {low:g} to {HEAD_MM:g}",
        unit_remedy(extent / 200.0) + f"; {_ONE_FACE}" * (extent > HEAD_MM),
    )


def _labelled_up(fits: list[FaceFit], axes: FloatArray | None) -> Iterable[PlausibilityFinding]:
    up = np.mean([fit.up for fit in fits], axis=0)
    degrees = float(np.degrees(np.arccos(np.clip(up[1] / np.linalg.norm(up), -1, 1))))
    if degrees <= TILTED_DEGREES:
        return
    yield PlausibilityFinding(
        "up",
        degrees > LYING_DEGREES,
        f"the head is tilted by {degrees:.0f} degrees from upright over the take, by its labels "
        f"(up to {TILTED_DEGREES:g} are usual)",
        _up_remedy(_axis_name(up, axes)),
    )


def _cloud_up(motion: SkinMotion, axes: FloatArray | None) -> Iterable[PlausibilityFinding]:
    """Return a finding for a cloud whose normal is vertical and whose motion is horizontal.

    Jaw, brows and lids move up and down, so that the main motion of an upright face is vertical.
    """
    level = np.sqrt(0.5)
    if not motion.depth.any() or not motion.main.any():
        return
    if motion.height(motion.depth) <= level or motion.height(motion.main) >= level:
        return
    up = (motion.rotations @ motion.main).mean(axis=0)
    yield PlausibilityFinding(
        "up",
        False,
        "the face seems to look straight up or down over the take, by its flat shape and by what "
        "moves most",
        _up_remedy(_axis_name(up, axes, signed=False)),
    )


def _axis_name(up: FloatArray, axes: FloatArray | None, *, signed: bool = True) -> str:
    """Return the axis of the file nearest to a direction of the take; empty if unknown."""
    if axes is None:
        return ""
    raw = axes.T @ up
    at = int(np.abs(raw).argmax())
    return ("-" if signed and raw[at] < 0 else "") + "xyz"[at]


def _up_remedy(axis: str) -> str:
    named = f"--up {axis}" if axis else "--up"
    return f"state which axis of the file is up with {named}, or the present one if it does lie so"


def _mirrored(fits: list[FaceFit]) -> Iterable[PlausibilityFinding]:
    right = float(np.median([fit.explained for fit in fits]))
    mirrored = float(np.median([fit.explained_mirrored for fit in fits]))
    if (1 - right) < _MIRRORED_RATIO * (1 - mirrored):
        return
    yield PlausibilityFinding(
        "sides",
        bool(np.median([fit.marker_count for fit in fits]) >= _FEWEST_MIRRORED),
        "left and right are exchanged: by their labels the markers lie as in the mirror image of "
        f"a face ({mirrored:.0%} of their spread explained, {right:.0%} by a face)",
        "name what is wrong with --mirrored labels (left is labelled right) or --mirrored axes "
        "(the file's axes are left-handed), or keep it with --mirrored no",
    )


def _part(labels: Sequence[str], seen: BoolArray) -> Iterable[PlausibilityFinding]:
    """Return findings for parts of the face without a labelled marker that is ever seen."""
    hints = [
        label_hint(label)
        for label, any_ in zip(labels, np.atleast_1d(seen.any(axis=0)), strict=True)
        if any_
    ]
    left, right = (sum(hint.side == side and bool(hint.region) for hint in hints) for side in "LR")
    upper, lower = (sum(hint.region in part for hint in hints) for part in (_UPPER, _LOWER))
    unnamed = sum(not hint.region for hint in hints)
    known = 2 * unnamed < len(hints)
    for count, other, words in (
        (left, right, "right side"),
        (right, left, "left side"),
        (upper, lower, "lower half"),
        (lower, upper, "upper half"),
    ):
        if count >= _FEWEST_OF_A_PART and other == 0:
            yield PlausibilityFinding(
                "part",
                known,
                f"no marker is labelled on the {words} of the face, {count} on the other: nothing "
                "can be solved there"
                + ("" if known else f", unless {unnamed} without such a label cover it"),
                "label its markers, or state with --partial that it has none",
            )


def _speed(motion: SkinMotion) -> Iterable[PlausibilityFinding]:
    fast = float(np.quantile(motion.speeds, 0.99)) if len(motion.speeds) else 0.0
    if fast > SPEED_RANGE_MM_S:
        yield _rate_finding(
            f"the skin moves over the skull at {fast:.0f} mm/s in one sample of a hundred, and a "
            f"blink at {SPEED_RANGE_MM_S:g} to {SPEED_LIMIT_MM_S:g}",
            impossible=fast > SPEED_LIMIT_MM_S,
        )


def _rate_finding(message: str, *, impossible: bool) -> PlausibilityFinding:
    return PlausibilityFinding(
        "rate",
        impossible,
        message,
        "state the frames per second of the capture with --rate, and look for labels that jump",
    )
