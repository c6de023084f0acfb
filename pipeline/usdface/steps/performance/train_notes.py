"""Notes on what training found: in the pairs, in their keys, and in what markers show."""

import json
from pathlib import Path

import numpy as np

from usdface.core.assets import References, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.sidecars import proposed_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.mapping.head_space import pose_error_note
from usdface.model.placement.shape_parts import missing_parts_note
from usdface.numerics.measure.face_regions import gaze_and_tongue_shapes, mirrored_shapes
from usdface.usdio.references.weight_layers import read_proposals

_LEAST_GAIN_DEVIATION = 0.03
"""Standard deviation of the gains of pairs that is reported; one animator's own is of that size."""

_CRITICAL_T = 3.0
"""All keys count as mirrored if Student's t of the mean cosine between the asymmetries of keys and
proposals is below its negative."""
_MIRRORED_COSINE, _LEAST_ASYMMETRY = -0.5, 0.15
_LEAST_ASYMMETRY_SHARE = 0.3
"""A pair counts as mirrored below this cosine; least length of both asymmetries, and of that of the
keys relative to the keys: what is left of symmetric expressions by keys with errors of 15 %."""


def training_notes(mapping: TrainedMapping, references: References) -> list[str]:
    """Return notes on corrected or omitted pairs, and on shapes that markers do not show."""
    notes = list(filter(None, [missing_parts_note(references.parts)]))
    low, high = mapping.ranges.T
    limited = (references.weights < low) | (references.weights > high)
    if limited.any():
        beyond = [mapping.shape_names[column] for column in np.flatnonzero(limited.any(axis=0))]
        notes.append(
            f"{pluralize(int(limited.sum()), 'weight')} of the pairs outside the range of "
            f"{first_few(beyond, most=3)}, clamped to it: state the range on the rig "
            "(`face:range`) if it is larger, or tune these pairs again"
        )
    still = str(mapping.settings.get("still_regions", ""))
    if still:
        notes.append(
            f"no reference moves the {still.replace(',', ', ')}: weights there follow from the "
            "rig's geometry only; tune frames in which they move"
        )
    unmarked = str(mapping.settings.get("unseen_regions", ""))
    if unmarked:
        notes.append(
            f"no marker is on the {unmarked.replace(',', ' and the ')}: weights there are "
            "extrapolated from the rest of the face; key them with `usdface edit`, or capture "
            "them with markers"
        )
    unseen = [
        references.shape_names[column]
        for column in gaze_and_tongue_shapes(references.parts)
        if references.weights[:, column].any()
    ]
    if unseen:
        notes.append(
            f"markers do not show gaze and tongue: {first_few(unseen, most=2)} "
            f"{'is' if len(unseen) == 1 else 'are'} inferred from the rest of the face, and not "
            "included in the uncertainty; key them with `usdface edit`"
        )
    notes += _offset_notes(references, mapping)
    pose_error_mm = float(mapping.settings.get("pose_error_mm", 0.0))
    if pose_error_mm:
        notes.append(pose_error_note("the references", pose_error_mm))
    key_error = float(mapping.settings.get("key_error", 0.0))
    if key_error:
        notes.append(
            f"keys and markers differ by about {key_error:.0%} of the keys, as with inaccurate "
            "keys or landmarks of a video; face_map corrects keys towards the markers, other "
            "methods do not"
        )
    if mapping.settings.get("unset_keys"):
        notes.append(
            "by the markers, shapes that are 0 in the pairs are not at rest, as if only the "
            "largest were keyed: face_map follows the markers, other methods learn the zeros. Key "
            "the smaller ones as well: it halves the error, or more"
        )
    notes += [*_gain_notes(mapping), *_wrong_key_notes(mapping)]
    repeated = len(references.frames) - int(mapping.settings["pairs"])
    if repeated:
        notes.append(
            f"left out {pluralize(repeated, 'pair')} with the markers and weights of another"
        )
    return notes


def _offset_notes(references: References, mapping: TrainedMapping) -> list[str]:
    takes = json.loads(str(mapping.settings["pair_takes"]))
    sizes = zip(takes, mapping.arrays["take_offset_mm"].tolist(), strict=True)
    moved = [f"{take} ({size:.1f} mm)" for take, size in sizes if size]
    if not moved:
        return []
    return [
        f"by the keys, the markers of {first_few(moved)} are offset from {references.neutral_take},"
        " as if applied again or by an expression held throughout: the offset is removed"
    ]


def _wrong_key_notes(mapping: TrainedMapping) -> list[str]:
    """Return notes on keys that are late, that markers contradict, and that were forgotten."""
    delays, contradicted, forgotten = (
        str(mapping.settings.get(name, "")) for name in ("key_delays", "contradicted", "forgotten")
    )
    notes = []
    if delays:
        notes.append(
            f"by the markers, the keys of {first_few(delays.split('; '))} are not in sync with the "
            "capture; the mapping is trained on the markers of the times that they describe. "
            "Correct the video with `usdface align --offset` before more frames are keyed"
        )
    if contradicted:
        notes.append(
            f"markers contradict the keys of {first_few(contradicted.split('; '))}: check these "
            "pairs"
        )
    if forgotten:
        notes.append(
            f"all keys are 0, but the markers move, at the {forgotten}: key them, if they were "
            "forgotten"
        )
    return notes


def _gain_notes(mapping: TrainedMapping) -> list[str]:
    """Return a note if keys of some pairs are larger than those of others, by author."""
    deviation = float(mapping.settings.get("gain_deviation", 0.0))
    if deviation < _LEAST_GAIN_DEVIATION:
        return []
    gains = str(mapping.settings.get("author_gains", ""))
    whose = (
        f"mean gain by author: {gains.replace(';', ',')}"
        if gains
        else "give the authors with `usdface references import --author`, as one gain for all keys "
        "of an author is more exact"
    )
    return [
        f"keys of the same expressions differ in gain between pairs, with a standard deviation of "
        f"{deviation:.0%}, as those of several animators do; face_map uses their mean; {whose}"
    ]


def mirrored_notes(path: Path, references: References) -> list[str]:
    """Return a note on tuned pairs that are asymmetric the other way round than their proposals.

    `path`: of the references.
    """
    rows = np.flatnonzero(references.tuned)
    try:
        proposals = read_proposals(proposed_path(path), references)
    except InputError:  # pairs without proposals, or with those of another rig
        return []
    other = mirrored_shapes(references.shape_names)
    weights = np.stack([references.weights[rows], proposals[rows]])
    weights[:, :, gaze_and_tongue_shapes(references.shape_names)] = 0.0
    asymmetries = weights - weights[:, :, other]
    sizes = np.linalg.norm(asymmetries, axis=2)
    cosine = np.prod(asymmetries, axis=0).sum(axis=1) / np.maximum(np.prod(sizes, axis=0), 1e-12)
    known = sizes.min(axis=0) > _LEAST_ASYMMETRY
    judged = cosine[known]
    if len(judged) > 1 and judged.mean() < -_CRITICAL_T * judged.std() / len(judged) ** 0.5:
        which = "the keys"
    else:
        one_sided = sizes[0] > _LEAST_ASYMMETRY_SHARE * np.linalg.norm(weights[0], axis=1)
        wrong = rows[known & one_sided & (cosine < _MIRRORED_COSINE)]
        if not len(wrong):
            return []
        which = counted((1 + wrong).tolist(), "pair")
    return [
        f"left and right may be exchanged in {which}: where the rig's own solve of the markers "
        "leans to one side, they lean to the other; M on the tuning page mirrors a pair"
    ]
