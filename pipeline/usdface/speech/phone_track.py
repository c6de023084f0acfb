"""What is said when: phones, words and emotions as spans of time."""

from bisect import bisect_right
from dataclasses import dataclass


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
