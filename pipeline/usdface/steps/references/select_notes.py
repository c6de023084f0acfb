"""Notes of `select`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from usdface.core.text import counted, first_few, pluralize, shell_word
from usdface.model.selection.design import ReferenceChoice
from usdface.model.selection.neutral_check import find_better_neutral
from usdface.specs.references import SelectSpec
from usdface.speech.phones import VISEMES, viseme_label
from usdface.steps.inputs.phone_labels import PhoneLabels
from usdface.steps.inputs.scene import SelectionScene
from usdface.steps.inputs.tuned_pairs import PlacedPair


def selection_notes(
    spec: SelectSpec,
    scene: SelectionScene,
    spoken: PhoneLabels,
    kept: Sequence[PlacedPair],
    choice: ReferenceChoice,
) -> list[str]:
    """Return notes on omitted markers, neutral faces, kept pairs, visemes and proposals."""
    takes = scene.takes
    notes, dropped = list(spoken.notes), takes.dropped
    if dropped:
        notes.append(
            f"left out {pluralize(len(dropped), 'marker')}, not in every take or seen in less than "
            f"half of the frames: {first_few(dropped)}"
        )
    usable = np.flatnonzero(takes.usable[0].all(axis=1))
    better = find_better_neutral(scene.equation, takes.positions[0], usable)
    if better is not None:
        frame = int(takes.frames[better.row])
        notes.append(
            f"{takes.sources[0].name}: its neutral frame is not neutral: the residual of the rig's "
            f"shapes is {better.stated_mm:.1f} mm with it, and {better.residual_mm:.1f} mm with "
            f"frame {frame}. Clean the take with --neutral {frame}, or another frame of the face "
            "at rest"
        )
    for take, neutral in zip(takes.sources, takes.neutrals, strict=True):
        notes += neutral.notes(take.name)
    if kept:
        notes.append(f"kept in place: {pluralize(len(kept), 'tuned pair')}")
    keyed = sum(each.is_keyed for each in kept)
    if keyed:
        notes.append(f"keyed in the asset, and now marked as tuned: {pluralize(keyed, 'pair')}")
    if spoken.segments and spec.method in ("viseme", "both"):
        notes += _viseme_notes(spoken, choice)
    if spec.method == "both" and not spec.phones:
        notes.append(
            "no phones are given, so frames were chosen by design only; accuracy is the same, but "
            "pairs have no viseme"
        )
    if spec.mapping is None:
        notes += scene.notes
    else:
        notes.append("the proposals are predictions of the mapping")
    return notes


def _viseme_notes(labels: PhoneLabels, choice: ReferenceChoice) -> list[str]:
    """Return notes on how many frames were chosen by which rule, and on missing visemes."""
    visemes, extremes = len(choice.visemes), len(choice.extremes)
    rest = len(choice.rows) - visemes - extremes
    notes = [
        f"chosen: {pluralize(visemes, 'frame')} of visemes, {pluralize(extremes, 'extreme')} of "
        f"emotions, {rest} by design"
    ]
    spoken = {segment.viseme for segment in labels.segments}
    silent = [viseme_label(viseme) for viseme in VISEMES if viseme not in spoken]
    if silent:
        notes.append(
            f"not spoken: {pluralize(len(silent), 'viseme')} of {len(VISEMES)}: "
            f"{first_few(silent, most=len(VISEMES))}"
        )
    some = [f"{v} {e}".strip() for e, v in choice.missing if v in spoken]
    if some:
        notes.append(f"spoken, but not in every emotion: {counted(some, 'viseme', most=8)}")
    return notes


def next_step(out: Path, count: int, kept: int) -> list[str]:
    """Return the next step if some of `count` pairs are proposals; `kept` of them are tuned."""
    rest = count - kept
    if not rest:
        return []
    if kept:
        return [f"next: tune some of the {pluralize(rest, 'proposal')}, then `usdface train`"]
    return [
        "an untuned start: all weights are proposals from the rig's geometry. Next: `usdface tune "
        f"{shell_word(out)}`; tune the first dozen or two (pairs are in order of their gain in "
        "coverage), then `usdface train`, which leaves out the rest"
    ]
