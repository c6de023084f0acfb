"""What is said when: phones, words and emotions as spans of time."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array


@dataclass(frozen=True)
class Span:
    """Something that lasts."""

    start: float
    end: float
    """`start`, `end`: [s], on the clock of the sound that was aligned."""
    label: str
    """A phone, a word or an emotion, as its file writes it."""

    @property
    def middle(self) -> float:
        """Half-way through [s]."""
        return (self.start + self.end) / 2


@dataclass(frozen=True)
class PhoneTrack:
    """Everything that is known of a recording's speech."""

    phones: tuple[Span, ...]
    """In order of time, silences included where the file has them."""
    words: tuple[Span, ...] = ()
    """Empty where the file has none."""
    emotions: tuple[Span, ...] = ()
    """Empty where the file marks none."""
    duration: float = 0.0
    """[s]"""


def label_at(spans: tuple[Span, ...], seconds: float) -> str:
    """Return the label of the span that holds a moment; empty where none does."""
    place = bisect_right([span.start for span in spans], seconds) - 1
    if place < 0 or seconds >= spans[place].end:
        return ""
    return spans[place].label


STEP_SECONDS = 0.02

LOUD_SHARE = 0.1
"""Of the level that only a twentieth of the recording exceeds: 20 dB below speech is a pause."""

INCOMPLETE_SHARE = 0.45
"""Share of the sound outside all words from which a transcript is thought to lack some. Recordings
of people with all their words leave 0.26 to 0.27, breath and room; with half of them 0.59 to 0.72,
with one word 0.80 to 0.98."""


def loud_moments(samples: Float32Array, *, rate: int) -> BoolArray:
    """Return which steps of `STEP_SECONDS` hold sound rather than a pause."""
    size = round(STEP_SECONDS * rate)
    steps = samples[: len(samples) // size * size].reshape(-1, size).astype(np.float64)
    if not len(steps):
        return np.zeros(0, dtype=np.bool_)
    level = np.sqrt(np.mean(steps**2, axis=1))
    loud: BoolArray = level > LOUD_SHARE * np.quantile(level, 0.95)
    return loud


def share_outside(samples: Float32Array, words: Sequence[Span], *, rate: int) -> float:
    """Return the share of the sound that no word accounts for [0-1].

    Parameters
    ----------
    samples : (samples,) float32 array
        Mono.
    """
    loud = loud_moments(samples, rate=rate)
    middle = (np.arange(len(loud)) + 0.5) * STEP_SECONDS
    inside = np.zeros(len(loud), dtype=np.bool_)
    for word in words:
        inside |= (middle >= word.start) & (middle < word.end)
    return float((loud & ~inside).sum() / max(int(loud.sum()), 1))
