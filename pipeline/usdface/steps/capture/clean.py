"""Clean a captured take; the cleaned take is a stronger layer over it."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, runs
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError, as_input_error
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import samples_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.placement.label_hints import (
    are_image_landmarks,
    is_on_headgear,
    label_hint,
    skin_motion_mm,
)
from usdface.numerics.repair.cleaning import clean_markers
from usdface.numerics.rigid.rigid_alignment import FEWEST_RIGID
from usdface.numerics.rigid.rigid_markers import RigidMarkers, find_rigid_markers
from usdface.runner.result import StepResult
from usdface.specs.capture import CleanSpec
from usdface.steps.capture.clean_notes import cleaning_figures, cleaning_notes, cleaning_summary
from usdface.steps.inputs.cleaned_takes import check_neutral_frame
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

LONGEST_GAP_SECONDS = 2.0
"""Longest gap filled by default: in longer ones, other markers hardly predict the missing one."""

_SKULL_MOTION_MM = 1.0
"""Largest motion on the head of markers that count as those of the skull."""

_PROVEN_MOTION_MM = 0.3
"""Largest residual motion of head-band markers that are used as rigid without being named."""

_LEAST_HINTED_SHARE = 0.6
"""Share of the markers whose labels must name a part of the face for labels to be used."""

_NEVER_RIGID = ("lid", "mouth", "chin", "jaw")
"""Regions whose markers are not detected as rigid: in some takes they move as one body."""

_SOFT_REGIONS = ("lid", "brow", "cheek", "mouth", "chin", "jaw")

_COPIED_SECONDS = 0.5
"""A marker at exactly one position for this long was not measured: measured positions have
noise."""
_COPY_CHANCE = 1e-5
"""Chance of a run of repeated positions, by the share of them that rounding leaves in the marker's
track, below which it was not measured, if most other markers move: a gap filled with the last
position. Of 0.1 % repeated 2 frames suffice, of 5 % 4, of 30 % 10."""
_STUCK_SHARE = 0.05
"""Share of the markers: if more stay at one position, the take is a simulation without noise."""

_REPEATED_SHARE = 0.15
"""Share of the frames that repeat the one before, above which a slower capture was written at this
rate: a fifth for 24 frames per second at 30, half for 60 at 120."""

_LISTED_RIGID = 24
"""Names listed; further ones, of a dense set, are counted."""


def run(spec: CleanSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Stabilise, relabel, fill and smooth the markers of a take."""
    take = read_take(spec.take)
    markers = _check_captured(spec, take)
    neutral = markers.neutral_frame if spec.neutral is None else spec.neutral
    markers, notes = _without_copies(markers, take, neutral)
    rigid, prior = _head_markers(spec, take, markers, notes)
    _check_neutral(spec, take, markers, rigid, neutral)
    usual_gap = round(LONGEST_GAP_SECONDS * float(take.rate))
    with as_input_error(f"{spec.take}: cannot be cleaned"):
        cleaned = clean_markers(
            markers.positions,
            markers.visible,
            rigid=[markers.names.index(name) for name in rigid],
            neutral=neutral - take.first_frame,
            rate=float(take.rate),
            skin_motion_mm=prior,
            max_gap=usual_gap if spec.max_gap is None else spec.max_gap,
            smooth=spec.smooth,
            # A model names landmarks by what they show.
            relabel=spec.relabel and not are_image_landmarks(markers.names),
            progress=part(progress, 0.1, 0.9),
        )
    notes += cleaning_notes(cleaned, markers, take)
    progress(0.9, f"writing {spec.out.name}")
    still = Markers(
        names=markers.names,
        positions=cleaned.positions,
        visible=cleaned.visible,
        # Smoothing does not raise the tracker's confidence; filling replaces it.
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
    return StepResult(
        tuple(dict.fromkeys((spec.out, samples_path(spec.out)))),
        cleaning_summary(cleaned, take),
        tuple(notes),
        cleaning_figures(cleaned, rigid),
    )


def _check_captured(spec: CleanSpec, take: Take) -> Markers:
    """Return a take's markers; refuse a take that has none or is cleaned already."""
    if take.markers is None:
        raise InputError(f"{spec.take}: has no markers to clean; ingest a capture that has")
    seen = take.markers.visible.any(axis=0)
    if not seen.all():
        never = [take.markers.names[column] for column in np.flatnonzero(~seen)]
        raise InputError(
            f"{spec.take}: never shows {counted(never, 'marker')}; ingest the capture again, which "
            "leaves them out"
        )
    # A second HeadMotion would replace the first in the stronger layer.
    if take.markers.space == "stabilized" and take.head_motion is not None:
        raise InputError(
            f"{spec.take}: is cleaned already; clean the captured take, the layer below it, with "
            "other options"
        )
    return take.markers


def _check_neutral(
    spec: CleanSpec, take: Take, markers: Markers, rigid: tuple[str, ...], neutral: int
) -> None:
    """Refuse a neutral frame that is not in the take, or that shows too few rigid markers."""
    check_neutral_frame(spec.take, neutral, take, "name another with --neutral")
    row = neutral - take.first_frame
    shown = int(markers.visible[row, [markers.names.index(name) for name in rigid]].sum())
    if shown < FEWEST_RIGID:
        raise InputError(
            f"{spec.take}: {shown} of the rigid markers {', '.join(rigid)} are visible at the "
            f"neutral frame {neutral}, {FEWEST_RIGID} are needed; choose another frame with "
            "--neutral, or name more markers with --rigid"
        )


def _head_markers(
    spec: CleanSpec, take: Take, markers: Markers, notes: list[str]
) -> tuple[tuple[str, ...], FloatArray | None]:
    """Return the rigid markers and, if all markers are used, the expected motion of each [mm].

    In this order: named markers; those labelled as on a head band, or with labels of no part of the
    face among labels of parts, if their mutual distances are constant; all markers, weighted by the
    parts of the face in their labels; a detected set of constant distances, none labelled as on
    jaw, mouth or lids, which differs between takes (the forehead in one, cheeks in another).
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
    regions = [label_hint(name).region for name in markers.names]
    labelled = sum(map(bool, regions)) >= _LEAST_HINTED_SHARE * len(regions)
    worn = [index for index, name in enumerate(markers.names) if is_on_headgear(name)]
    no_part = [index for index, region in enumerate(regions) if labelled and not region]
    for columns, labels in ((worn, "of a head band by"), (no_part, "of no part of a face by")):
        with contextlib.suppress(ValueError):
            found = _find_rigid(markers, columns)
            if found.is_rigid and found.residual_motion_mm <= _PROVEN_MOTION_MM:
                names = tuple(markers.names[columns[index]] for index in found.indices)
                notes.append(
                    f"no rigid markers were named; {first_few(names)}, {labels} their labels, are "
                    f"used (their distances vary by {found.deviation_mm:.2f} mm)"
                )
                return names, None
    motion = skin_motion_mm(markers.names)
    still = tuple(
        name for name, mm in zip(markers.names, motion, strict=True) if mm <= _SKULL_MOTION_MM
    )
    if len(still) > FEWEST_RIGID and labelled:
        notes.append(
            "no rigid markers were named; the head's pose is estimated from all markers, weighted "
            f"by the rigidity of their part of the face ({first_few(still)} have most weight)"
        )
        return still, motion
    firm = [index for index, region in enumerate(regions) if region not in _NEVER_RIGID]
    if len(firm) <= FEWEST_RIGID:
        firm = list(range(len(markers.names)))
    try:
        found = _find_rigid(markers, firm)
    except ValueError as error:
        raise InputError(
            f"{spec.take}: no rigid markers are named and none were detected: {error}, with --rigid"
        ) from error
    names = tuple(markers.names[firm[index]] for index in found.indices)
    notes.append(
        f"no rigid markers were named; {first_few(names, most=_LISTED_RIGID)} were detected "
        f"(their distances vary by {found.deviation_mm:.2f} mm)"
    )
    if not found.is_rigid:
        notes.append(
            f"these markers leave {np.rad2deg(found.rotation_error):.1f} degrees of error in the "
            "head's rotation, of which mapping removes a part; name markers of the skull with "
            "--rigid (head band, temples, bridge of the nose), if there are any"
        )
    notes += _soft_notes(names)
    return names, None


def _find_rigid(markers: Markers, columns: Sequence[int]) -> RigidMarkers:
    """Detect markers of constant mutual distances among some columns."""
    # Frames without any marker are padding.
    recorded = np.flatnonzero(markers.visible.any(axis=1))
    positions, visible = markers.positions, markers.visible
    if len(columns) < len(markers.names):
        positions, visible = positions[:, columns], visible[:, columns]
    rows = slice(None) if len(recorded) == len(visible) else recorded  # long takes are not copied
    return find_rigid_markers(positions[rows], visible[rows])


def _soft_notes(names: tuple[str, ...]) -> list[str]:
    """Return a note on rigid markers whose labels name skin that moves."""
    soft = [name for name in names if label_hint(name).region in _SOFT_REGIONS]
    if not soft:
        return []
    return [
        f"{first_few(soft)} {'is' if len(soft) == 1 else 'are'} used as rigid, but labelled as on "
        "skin that moves, which disturbs the head's pose; name markers of the skull with --rigid"
    ]


def _without_copies(markers: Markers, take: Take, neutral: int) -> tuple[Markers, list[str]]:
    """Return markers with samples that repeat one position marked as not visible, and notes.

    Nothing is marked if several markers do so for most of the time in which others move: that is a
    simulation.
    """
    seen, same = markers.visible, np.zeros_like(markers.visible)
    same[1:] = (markers.positions[1:] == markers.positions[:-1]).all(axis=2) & seen[1:] & seen[:-1]
    frozen = _find_copies(
        same, seen, _COPIED_SECONDS * float(take.rate), neutral - take.first_frame
    )
    moving = ~np.all(frozen | ~seen, axis=1)
    stuck = frozen[moving].mean(axis=0) > 0.5 if moving.any() else np.ones(len(seen.T), np.bool_)
    if stuck.mean() > _STUCK_SHARE:
        return markers, []
    notes = []
    if stuck.any():
        names = [markers.names[marker] for marker in np.flatnonzero(stuck)]
        notes.append(
            f"exactly one position for most of the take: {first_few(names)}; export without them"
        )
    frozen[:, stuck] = False
    every = np.any(frozen, axis=1) & np.all(frozen | ~seen | stuck, axis=1)
    some = frozen & ~every[:, None]
    names = [name for name, each in zip(markers.names, some.any(axis=0), strict=True) if each]
    for rows, frozen_names in ((every, "every marker"), (some.any(axis=1), first_few(names))):
        spans = runs(rows)
        frames = [f"{take.first_frame + a}-{take.first_frame + b - 1}" for a, b in spans]
        if frames:
            notes.append(
                f"exactly one position for {pluralize(int(rows.sum()), 'frame')} "
                f"({first_few(frames)}): {frozen_names}. A frozen stream, or gaps filled with the "
                "last position: treated as gaps. Export without filling"
            )
    copied = np.any(same & ~stuck, axis=1) & np.all(same | ~seen, axis=1)
    repeated = float(copied[~every].mean())
    if repeated > _REPEATED_SHARE:
        notes.append(
            f"{repeated:.0%} of the frames repeat the one before exactly: captured at about "
            f"{float(take.rate) * (1 - repeated):.3g} frames per second and written at "
            f"{float(take.rate):.4g}, so motion is stepped. Export at the rate of the capture"
        )
    return replace(markers, visible=seen & ~frozen), notes


def _find_copies(same: BoolArray, seen: BoolArray, longest: float, neutral: int) -> BoolArray:
    """Return the repeated samples, (frames, markers), that were not measured.

    Those of runs of `longest` frames; of shorter ones that are improbable, as in filled gaps; and
    of frames that repeat as a whole, as recorders write for dropped ones, but for the neutral one.
    """
    alone = same & (same.sum(axis=1) < 0.5 * seen.sum(axis=1))[:, None]
    share = np.clip(same.sum(axis=0) / np.maximum(seen.sum(axis=0), 1), 1e-9, 1 - 1e-9)
    improbable = np.minimum(np.log(_COPY_CHANCE) / np.log(share), longest)
    copies = np.zeros_like(same)
    for marker in np.flatnonzero(same.any(axis=0)):
        for column, least in ((same, longest), (alone, improbable[marker])):
            for start, stop in runs(column[:, marker]):
                copies[start:stop, marker] |= stop - start >= least
    whole = np.any(same, axis=1) & np.all(same | ~seen, axis=1)
    if whole.mean() <= _REPEATED_SHARE:
        whole &= np.arange(len(whole)) != neutral
        copies[whole] = same[whole]
    return copies
