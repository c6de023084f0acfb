"""Side, region of the face and landmark that a marker's label names.

Labels are hints: a placement weights them by the standard deviation with which people put such
markers. A label without a known word has no effect.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.measure.face_regions import swap_side

Side = str
"""``'L'``, ``'R'`` or empty."""

_LEFT_RIGHT = re.compile(
    r"""^(?P<front>l|r|left|right)(?=[_\-. ]|(?:up(?:per)?|lo(?:w(?:er)?)?|in(?:ner)?|out(?:er)?|
        mid(?:dle)?)?(?:eye|bro|cheek|mouth|lip|nos|nstr|lid|chin|jaw|ear|temple|fore|front|f?hd|
        f?head|orb|c\d))
      | (?:(?<=[_\-. ])|(?<=[a-z]))(?P<back>l|r|left|right)(?=\d*$|end$|[_\-. ])""",
    re.VERBOSE | re.IGNORECASE,
)
_INNER_WORD = re.compile(r"insid|inner|_in\b|_in_|inn|(?:brow|bro|eye)in(?![a-z])")
_OUTER_WORD = re.compile(r"outsid|outer|_out\b|_out_|out")
_UPPER_WORD = re.compile(r"up|top")
_LOWER_WORD = re.compile(r"down|low|bot|lo_?li[pd]")
_WORN = re.compile(r"head|skull|cap|band")
_NOT_A_SIDE = re.compile(r"^(lip|lid|low|lower|root|ridge|rim)", re.IGNORECASE)
_SIDED_WORD = re.compile(
    r"""(?:brow?|eye|lid|nose|nasi|nstr|cheek|mouth|lip|chin|jaw|ear|temple|forehead|f?head|f?hd|skull
        |orbi?|corner|upper|lower|inner|outer|up|low|in|out|mid|middle)$""",
    re.VERBOSE | re.IGNORECASE,
)
"""End of what a side follows without a separator, in the same case: ``EYER``, but not ``LOWER``."""


@dataclass(frozen=True)
class LabelHint:
    """Side, region and landmarks named by one label."""

    side: Side = ""
    """``'L'``, ``'R'`` or empty: the performer's."""
    region: str = ""
    """forehead, brow, bridge, nose, lid, eye corner, eye, mouth, chin, jaw, cheek, skull; empty if
    the label names none."""
    landmarks: tuple[str, ...] = ()
    """Landmarks of `rig_landmarks`, whose mean is the position; empty if only the region is
    known."""
    spread_mm: float = 0.0
    """Standard deviation with which people put such a marker, on an adult's face."""


def side_of_label(label: str) -> Side:
    """Return the side that a label names, as in ``Leye_Up``, ``brow_L2`` or ``Mouth_Lend``."""
    name = label.strip()
    for found in _LEFT_RIGHT.finditer(name):
        if found["front"] and _NOT_A_SIDE.match(name):
            continue
        if found["back"] and _ends_a_word(name, found):
            continue
        return (found["front"] or found["back"])[0].upper()
    return ""


def _ends_a_word(name: str, found: re.Match[str]) -> bool:
    """Whether a side at the end is part of a word, as in ``cheekuper``, ``INNER`` or ``cleft``."""
    side, before = found["back"], name[: found.start("back")]
    if before[-1] in "_-. " or (side[0].isupper() and before[-1].islower()):
        return False
    return side in ("l", "r") or not _SIDED_WORD.search(before)


def upper_lid_sides(labels: Sequence[str]) -> set[Side]:
    """Return the sides of the face with a marker whose label names the upper lid."""
    hints = [label_hint(label) for label in labels]
    return {hint.side for hint in hints if set(hint.landmarks) == {f"lid_crease_{hint.side}"}}


def mirrored_label(label: str) -> tuple[str, ...]:
    """Return possible labels of the same marker on the other side; empty without a side."""
    side, candidates = side_of_label(label), []
    for found in _LEFT_RIGHT.finditer(label):
        group = "front" if found["front"] else "back"
        if found[group][0].upper() == side:
            candidates.append(swap_side(label, found, group))
    return tuple(dict.fromkeys(candidates))


def mirror_partners(labels: Sequence[str]) -> dict[str, str]:
    """Return the label of the other side for every label that has one in the set.

    Case is ignored: real marker sets pair ``Lcheek_Up`` with ``Rcheek_up``.
    """
    by_name = {label.lower(): label for label in labels} | {label: label for label in labels}
    partners = {}
    for label in labels:
        for name in mirrored_label(label):
            partner = by_name.get(name, by_name.get(name.lower()))
            if partner is not None:
                partners[label] = partner
                break
    return partners


def label_hint(label: str) -> LabelHint:
    """Return the hint of a label; an empty one if no rule matches."""
    text, side = label.lower(), side_of_label(label)
    for part, read in _PARTS:
        if re.search(part, text):
            region, landmarks = read(text, side)
            spread = max((landmark_spread_mm(name) for name in landmarks), default=0.0)
            return LabelHint(side, region, landmarks, spread)
    return LabelHint(side)


def are_image_landmarks(labels: Iterable[str]) -> bool:
    """Return whether the markers are landmarks detected in images: of `track`, or OpenFace's."""
    return any(label.startswith(("iris_", "landmark_")) for label in labels)


def face_region(label: str) -> str:
    """Return the region of `face_regions.REGIONS` that a label names; ``''`` for none."""
    return _REGIONS.get(label_hint(label).region, "")


_REGIONS = {
    "forehead": "brows",
    "brow": "brows",
    "lid": "lids",
    "eye": "lids",
    "eye corner": "lids",
    "bridge": "cheeks and nose",
    "nose": "cheeks and nose",
    "cheek": "cheeks and nose",
    "mouth": "mouth",
    "chin": "jaw",
    "jaw": "jaw",
}


def is_on_headgear(label: str) -> bool:
    """Whether a label names a head band, a cap or the skull; not a forehead, ear or temple."""
    return label_hint(label).region == "skull" and bool(_WORN.search(label.lower()))


def landmark_spread_mm(name: str) -> float:
    """Return the standard deviation of markers about a landmark of an adult's face.

    0 for landmarks that carry no marker: one of the upper lid is glued above the lid's margin.
    """
    return _SPREAD_MM.get(re.sub("_[LR]$", "", name), 0.0)


def skin_motion_mm(labels: Sequence[str]) -> FloatArray:
    """Return the expected motion of each marker relative to the skull: (markers,) [mm]."""
    prior = []
    for label in labels:
        hint, text = label_hint(label), label.lower()
        motion = _SKIN_MOTION_MM[hint.region]
        if hint.region in _OUTER_MOTION_MM and _OUTER_WORD.search(text):
            motion = _OUTER_MOTION_MM[hint.region]
        elif hint.region == "nose" and hint.side:
            motion = _SIDE_OF_NOSE_MM
        prior.append(motion)
    return np.array(prior)


_SKIN_MOTION_MM = {
    "skull": 0.3,
    "bridge": 0.7,
    "nose": 0.9,
    "forehead": 1.0,
    "eye corner": 1.0,
    "eye": 2.0,
    "cheek": 2.5,
    "brow": 2.5,
    "lid": 3.0,
    "mouth": 4.0,
    "chin": 4.0,
    "jaw": 4.0,
    "": 2.0,
}
"""Standard deviation of the skin's motion relative to the skull, by region [mm]. Values above 4 mm
change nothing: such markers have almost no weight in the head's pose."""

_OUTER_MOTION_MM = {"brow": 1.5, "cheek": 2.0}
_SIDE_OF_NOSE_MM = 2.0

_SPREAD_MM = {
    "nose_tip": 4.0,
    "mouth": 6.0,
    "lip_upper": 8.0,
    "lip_lower": 8.0,
    "nose_bridge": 8.0,
    "eye_inner": 8.0,
    "eye_outer": 9.0,
    "brow_centre": 9.0,
    "brow_inner": 9.0,
    "brow_middle": 9.0,
    "brow_outer": 9.0,
    "chin": 10.0,
    "lid_crease": 12.0,
    "lid_lower": 12.0,
}

_Place = tuple[str, tuple[str, ...]]


def _brow(text: str, side: Side) -> _Place:
    if not side:
        return "brow", ("brow_centre",)
    part = (
        "inner" if _INNER_WORD.search(text) else "outer" if _OUTER_WORD.search(text) else "middle"
    )
    return "brow", (f"brow_{part}_{side}",)


def _nose(text: str, side: Side) -> _Place:
    if side:
        return "nose", ()
    if re.search(r"top|bridge|root|nasion", text):
        return "bridge", ("nose_bridge",)
    return "nose", ("nose_tip",)


def _eye(text: str, side: Side) -> _Place:
    if not side:
        return "eye", ()
    part = "crease" if _UPPER_WORD.search(text) else "lower" if _LOWER_WORD.search(text) else ""
    if not (part and "lid" in text):  # the outer marker of an upper lid is on the lid
        if _INNER_WORD.search(text):
            return "eye corner", (f"eye_inner_{side}",)
        if _OUTER_WORD.search(text):
            return "eye corner", (f"eye_outer_{side}",)
    if part:
        return "lid", (f"lid_{part}_{side}",)
    return "eye", (f"lid_crease_{side}", f"lid_lower_{side}")


def _mouth(text: str, side: Side) -> _Place:
    if re.search(r"above|below|under", text):  # on the skin beside the lips: no landmark
        return "mouth", ()
    part = "upper" if _UPPER_WORD.search(text) else "lower" if _LOWER_WORD.search(text) else ""
    if "end" in text or "corner" in text or (side and not part):
        return "mouth", (f"mouth_{side}",) if side else ()
    if not part:
        return "mouth", ()
    return "mouth", (f"lip_{part}", f"mouth_{side}") if side else (f"lip_{part}",)


def _only(region: str) -> Callable[[str, Side], _Place]:
    return lambda text, side: (region, ())


_PARTS = (
    (r"band", _only("skull")),
    (r"fore|front(?!al_)|fhd|fhead|^fh\d", _only("forehead")),
    (r"brow|bro\d|bro$", _brow),
    (r"nose|nasi|nostr|nstr", _nose),
    (r"eye|lid", _eye),
    (r"mouth|lip|^mou\d", _mouth),
    (r"chin|^ch\d", lambda text, side: ("chin", () if side else ("chin",))),
    (r"jaw", _only("jaw")),
    (r"cheek|orbi|^[lr]c\d", _only("cheek")),
    (r"ear|temple|head|skull|tragus|cap", _only("skull")),
)
"""The first match counts: ``band`` before ``fore``, ``brow`` before ``eye``, ``fore`` before
``head``. ``FH1``, ``MOU3``, ``CH2`` and ``RC7`` are abbreviations of IEMOCAP."""
