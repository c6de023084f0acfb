"""Phones and visemes at the frames of takes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import IntArray
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.selection.design import Segment
from usdface.specs.references import SelectSpec
from usdface.speech.phones import (
    SILENCE,
    PhoneTrack,
    Span,
    arpabet_of,
    spans_at,
    viseme_label,
    viseme_of,
)
from usdface.speech.track_files import read_phone_track, unknown_symbols
from usdface.steps.inputs.cleaned_takes import CleanedTakes

MARGIN_SECONDS = 5.0
"""Time by which phones may exceed their take; beyond it they are those of another."""


@dataclass(frozen=True)
class PhoneLabels:
    """Phones, visemes and emotions at the frames of all takes."""

    segments: tuple[Segment, ...]
    """Every phone that has a frame."""
    viseme_of: tuple[str, ...]
    """Of each frame; empty where unknown."""
    emotion_of: tuple[str, ...]
    """Of each frame; empty where unknown."""
    notes: tuple[str, ...]


def read_phone_labels(spec: SelectSpec, takes: CleanedTakes) -> PhoneLabels:
    """Read the phones of every take, and label its frames."""
    segments: list[Segment] = []
    visemes: list[str] = []
    emotions: list[str] = []
    notes: list[str] = []
    unmarked = []
    start = 0
    for index, source in enumerate(takes.sources):
        count = len(takes.positions[index])
        rate = float(source.rate)
        take_emotion = spec.emotions[index] if spec.emotions else source.emotion
        seconds = np.arange(count) / rate
        track = PhoneTrack(())
        if spec.phones:
            track = _read_track(spec.phones[index], source.name, count / rate)
            unknown = unknown_symbols(track)
            if unknown:
                notes.append(
                    f"{spec.phones[index].name}: {len(unknown)} symbols are no phone and were "
                    f"left out: {first_few(map(repr, unknown))}"
                )
        emotion_at = [
            take_emotion if span is None else span.label
            for span in spans_at(track.emotions, seconds)
        ]
        if not any(emotion_at):
            unmarked.append(source.name)
        for span in track.phones:
            row = round(span.middle * rate)
            viseme = viseme_of(span.label)
            if viseme is not None and 0 <= row < count:
                length = max(round((span.end - span.start) * rate), 1)
                segments.append(Segment(start + row, length, viseme, emotion_at[row]))
        visemes += [
            "" if span is None else viseme_of(span.label) or ""
            for span in spans_at(track.phones, seconds)
        ]
        emotions += emotion_at
        start += count
    if unmarked and (spec.phones or len(takes.sources) > 1):
        notes.append(
            f"no emotion is marked in {first_few(unmarked)}, so all frames count as one emotion; "
            "give it with --emotions, with `usdface ingest --emotion`, or in a tier `emotions`"
        )
    return PhoneLabels(tuple(segments), tuple(visemes), tuple(emotions), tuple(notes))


def _read_track(path: Path, take: str, take_seconds: float) -> PhoneTrack:
    """Read the phones of a take; refuse those of another."""
    track = read_phone_track(path)
    if track.duration > take_seconds + MARGIN_SECONDS:
        raise InputError(
            f"{path}: lasts {track.duration:.1f} s and its take {take} {take_seconds:.1f} s; give "
            "the phones of this take, for several takes in their order"
        )
    return track


def labels_at(phones: Path | None, take: Take, frames: IntArray) -> tuple[str, ...]:
    """Return phone, viseme and emotion of each frame, such as ``M  /b/ /p/ /m/``, else ``''``."""
    if phones is None:
        return ("",) * len(frames)
    track = _read_track(phones, take.name, take.frame_count / float(take.rate))
    seconds = take.seconds(np.asarray(frames, np.float64))
    spoken, emotions = spans_at(track.phones, seconds), spans_at(track.emotions, seconds)
    return tuple(_label_text(*each) for each in zip(spoken, emotions, strict=True))


def _label_text(phone: Span | None, emotion: Span | None) -> str:
    viseme = None if phone is None else viseme_of(phone.label)
    if phone is None or viseme is None:
        spoken = ""
    elif viseme == SILENCE:
        spoken = "silent"
    else:
        spoken = f"{(arpabet_of(phone.label) or '').upper()}  {viseme_label(viseme)}"
    return ", ".join(filter(None, [spoken, "" if emotion is None else emotion.label]))
