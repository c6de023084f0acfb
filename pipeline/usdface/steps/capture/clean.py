"""A captured take in, a cleaned one out: stronger, over the captured one."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray, runs
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import samples_path
from usdface.core.text import first_few, pluralize
from usdface.media.picture.image import write_image
from usdface.model.placement.label_hints import is_worn, label_hint, skin_motion_mm
from usdface.numerics.repair.cleaning import clean_markers
from usdface.numerics.rigid.rigid_markers import RigidMarkers, find_rigid_markers
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.capture import CleanSpec
from usdface.steps.capture.clean_notes import (
    cleaning_figures,
    cleaning_notes,
    cleaning_summary,
    repair_picture,
)
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

LONGEST_GAP_SECONDS = 2.0
"""What is filled by default: beyond, the other markers hardly tell what one did."""

_FEWEST_RIGID = 3
"""Seen at once, they tell the head's pose."""

_SKULL_MOTION_MM = 1.0
"""Markers that move by no more count as those of the skull."""

_PROVEN_MOTION_MM = 0.3
"""Own motion of markers on a head band: with no more, they are used as if they were named rigid."""

_LEAST_HINTED_SHARE = 0.6
"""Of the markers, whose labels must name a part of the face before labels are relied on."""

_SOFT_REGIONS = ("lid", "brow", "cheek", "mouth", "chin", "jaw")

_COPIED_SECONDS = 0.5
"""A marker that repeats its place to the last digit for so long is not seen: heads and noise
tremble."""
_STUCK_SHARE = 0.05
"""Of the markers: more that stay in one place are still skin of a simulation without noise."""

_REPEATED_SHARE = 0.15
"""Of the frames: with more that repeat the one before, a slower capture was written at this rate,
24 frames per second at 30 (a fifth) or 60 at 120 (half)."""

_LISTED_RIGID = 24
"""A face has no more to name; of a dense cloud the rest are counted."""


def run(spec: CleanSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Stabilise, relabel, fill and smooth the markers of a take."""
    progress(0.0, f"reading {spec.take.name}")
    take = read_take(spec.take)
    markers = _check_captured(spec, take)
    markers, notes = _without_copies(markers, take)
    rigid, prior = _head_markers(spec, take, markers, notes)
    neutral = markers.neutral_frame if spec.neutral is None else spec.neutral
    _check_neutral(spec, take, markers, rigid, neutral)
    max_gap = spec.max_gap
    if max_gap is None:
        max_gap = round(LONGEST_GAP_SECONDS * float(take.rate))
    try:
        cleaned = clean_markers(
            markers.positions,
            markers.visible,
            rigid=[markers.names.index(name) for name in rigid],
            neutral=neutral - take.first_frame,
            rate=float(take.rate),
            skin_motion_mm=prior,
            max_gap=max_gap,
            smooth=spec.smooth,
            relabel=spec.relabel,
            progress=part(progress, 0.1, 0.9),
        )
    except ValueError as error:
        raise InputError(f"{spec.take}: cannot be cleaned: {error}") from error
    notes += cleaning_notes(cleaned, markers, take)
    progress(0.9, f"writing {spec.out.name}")
    still = Markers(
        names=markers.names,
        positions=cleaned.positions,
        visible=cleaned.visible,
        # A sample that the tracker doubts is no better for being smoothed; one that was filled is.
        confidence=np.where(
            markers.visible, np.minimum(cleaned.confidence, markers.confidence), cleaned.confidence
        ),
        rigid=rigid,
        neutral_frame=neutral,
        anchor=markers.anchor,
        space="stabilized",
    )
    written = Take(
        name=take.name,
        rate=take.rate,
        first_frame=take.first_frame,
        markers=still,
        head_motion=cleaned.head_motion,
    )
    write_take(spec.out, written, over=spec.take, provenance=provenance)
    outputs = tuple(dict.fromkeys((spec.out, samples_path(spec.out))))
    if spec.report is not None:
        picture = repair_picture(cleaned, markers, take)
        write_image(spec.report, picture, metadata=provenance_metadata(provenance))
        outputs += (spec.report,)
    progress(1.0, "done")
    return StepResult(
        outputs, cleaning_summary(cleaned, take), tuple(notes), cleaning_figures(cleaned, rigid)
    )


def _check_captured(spec: CleanSpec, take: Take) -> Markers:
    """Return a take's markers, or refuse one that has none or is clean already."""
    if take.markers is None:
        raise InputError(f"{spec.take}: has no markers to clean")
    # A second head motion would hide the first, and the face would lose its head's.
    if take.markers.space == "stabilized" and take.head_motion is not None:
        raise InputError(
            f"{spec.take}: is clean already, its head motion removed; clean the captured take, "
            "the layer below it, with the options that you want"
        )
    return take.markers


def _check_neutral(
    spec: CleanSpec, take: Take, markers: Markers, rigid: tuple[str, ...], neutral: int
) -> None:
    """Refuse a neutral frame that is not in the take, or that shows too few rigid markers."""
    row = neutral - take.first_frame
    if not 0 <= row < take.frame_count:
        raise InputError(
            f"{spec.take}: neutral frame {neutral} is outside the take, {take.first_frame}-"
            f"{take.first_frame + take.frame_count - 1}; name one with --neutral"
        )
    shown = int(markers.visible[row, [markers.names.index(name) for name in rigid]].sum())
    if shown < _FEWEST_RIGID:
        raise InputError(
            f"{spec.take}: {shown} of the rigid markers {', '.join(rigid)} are seen at the neutral "
            f"frame {neutral}, {_FEWEST_RIGID} are needed; choose another with --neutral, or name "
            "more with --rigid"
        )


def _head_markers(
    spec: CleanSpec, take: Take, markers: Markers, notes: list[str]
) -> tuple[tuple[str, ...], FloatArray | None]:
    """Return the markers of the skull, and what takes their place where none are named.

    Named markers are used as they are, and so are those that labels put on a head band, if they
    keep their mutual distances. Otherwise labels that name parts of the face say how
    far each marker moves by itself; only where they are silent, a set that keeps its distances is
    sought: in one take it may be the forehead, in the next cheeks and chin.
    """
    named = spec.rigid or markers.rigid
    unknown = [name for name in named if name not in markers.names]
    if unknown:
        raise InputError(
            f"{spec.take}: rigid markers {', '.join(unknown)} are not in the take, which has "
            f"{first_few(markers.names)}; correct --rigid"
        )
    if named:
        notes += _soft_notes(named)
        return named, None
    worn = [index for index, name in enumerate(markers.names) if is_worn(name)]
    with contextlib.suppress(ValueError):
        found = _find_rigid(take, markers, worn)
        if found.residual_motion_mm <= _PROVEN_MOTION_MM:
            names = tuple(markers.names[worn[index]] for index in found.indices)
            notes.append(
                f"no rigid markers were named; {first_few(names)}, of a head band by their labels, "
                f"keep their mutual distances to {found.deviation_mm:.2f} mm and are used"
            )
            return names, None
    motion = skin_motion_mm(markers.names)
    still = tuple(
        name for name, mm in zip(markers.names, motion, strict=True) if mm <= _SKULL_MOTION_MM
    )
    hinted = sum(bool(label_hint(name).region) for name in markers.names)
    if len(still) > _FEWEST_RIGID and hinted >= _LEAST_HINTED_SHARE * len(markers.names):
        notes.append(
            "no rigid markers were named; the head's pose is estimated from all markers, each "
            f"weighted by how far its part of the face moves ({first_few(still)} count most)"
        )
        return still, motion
    try:
        found = _find_rigid(take, markers)
    except ValueError as error:
        raise InputError(
            f"{spec.take}: no rigid markers are named and none could be found: {error}"
        ) from error
    names = tuple(markers.names[index] for index in found.indices)
    notes.append(
        f"no rigid markers were named; {first_few(names, most=_LISTED_RIGID)} keep their mutual "
        f"distances to {found.deviation_mm:.2f} mm and are used"
    )
    notes += _soft_notes(names)
    return names, None


def _find_rigid(take: Take, markers: Markers, columns: Sequence[int] | None = None) -> RigidMarkers:
    """Look for markers that keep their distances, among some columns or all."""
    # A padded take is judged by the frames in which something was recorded.
    recorded = np.flatnonzero(markers.visible.any(axis=1))
    whole = len(recorded) == take.frame_count  # an hour of markers is not copied
    positions, visible = markers.positions, markers.visible
    if columns is not None:
        positions, visible = positions[:, columns], visible[:, columns]
    return find_rigid_markers(
        positions if whole else positions[recorded], visible if whole else visible[recorded]
    )


def _soft_notes(names: tuple[str, ...]) -> list[str]:
    """Say which rigid markers sit on skin that moves, by their labels."""
    soft = [name for name in names if label_hint(name).region in _SOFT_REGIONS]
    if not soft:
        return []
    return [
        f"{first_few(soft)} {'is' if len(soft) == 1 else 'are'} used as rigid, but the label names "
        "skin that moves: the head's pose follows the face; name markers of the skull with --rigid"
    ]


def _without_copies(markers: Markers, take: Take) -> tuple[Markers, list[str]]:
    """Take markers for unseen where they repeat one place, and say where; say what repeats often.

    Unless several do so in the larger part of the take: a still face, or a simulation of one.
    """
    seen, same = markers.visible, np.zeros_like(markers.visible)
    same[1:] = (markers.positions[1:] == markers.positions[:-1]).all(axis=2) & seen[1:] & seen[:-1]
    least = _COPIED_SECONDS * float(take.rate)
    frozen = np.zeros_like(same)
    for marker, column in enumerate(same.T):
        for start, stop in runs(column):
            frozen[start:stop, marker] = stop - start >= least
    stuck = frozen.mean(axis=0) > 0.5
    if stuck.mean() > _STUCK_SHARE:
        return markers, []
    notes = []
    if stuck.any():
        dead = first_few([markers.names[marker] for marker in np.flatnonzero(stuck)])
        notes.append(f"to the last digit in one place for most of the take: {dead}; export without")
    frozen[:, stuck] = False
    every = np.any(frozen, axis=1) & np.all(frozen | ~seen | stuck, axis=1)
    some = frozen & ~every[:, None]
    names = [name for name, each in zip(markers.names, some.any(axis=0), strict=True) if each]
    for rows, who in ((every, "every marker"), (some.any(axis=1), first_few(names))):
        spans = runs(np.asarray(rows))
        frames = [f"{take.first_frame + a}-{take.first_frame + b - 1}" for a, b in spans]
        if frames:
            notes.append(
                f"to the last digit in one place for {pluralize(int(rows.sum()), 'frame')} "
                f"({first_few(frames)}): {who}. A stream that froze, or gaps filled by holding; "
                "taken for unseen. Export without filling"
            )
    copied = np.any(same & ~stuck, axis=1) & np.all(same | ~seen, axis=1)
    repeated = float(copied[~every].mean())
    if repeated > _REPEATED_SHARE:
        notes.append(
            f"{repeated:.0%} of the frames repeat the one before to the last digit: captured at "
            f"about {float(take.rate) * (1 - repeated):.3g} frames per second and written at "
            f"{float(take.rate):.4g}; motion comes out in steps. Export at the rate of the capture"
        )
    return replace(markers, visible=seen & ~frozen), notes
