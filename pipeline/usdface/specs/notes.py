"""Notes of a review: the file that the report saves and other steps read."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from usdface.core.errors import InputError
from usdface.core.text import read_json
from usdface.specs.base import Spec
from usdface.specs.reading import validation_messages

NOTES_FORMAT = 1
LARGEST_NOTES_BYTES = 16 << 20
"""The size of a thousand notes, each with a drawing of a thousand points."""

_Frame = Annotated[int, Field(ge=-(10**9), le=10**9)]
_Weight = Annotated[float, Field(ge=-10.0, le=10.0)]


class NoteStroke(BaseModel):
    """A line drawn on a picture."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    on: Literal["face", "video"]
    points: Annotated[tuple[tuple[float, float], ...], Field(max_length=100_000)]
    """x to the right, y down, from the picture's centre, in units of its shorter side."""


class ReviewNote(BaseModel):
    """A note on a frame or a range of frames. Unknown keys are kept."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    id: Annotated[str, Field(min_length=1, max_length=200)]
    frame: _Frame
    last: _Frame | None = None
    """Last frame of a range."""
    text: Annotated[str, Field(max_length=4000)] = ""
    author: Annotated[str, Field(max_length=200)] = ""
    made: Annotated[str, Field(max_length=40)] = ""
    """Time of the last change, ISO 8601."""
    version: Annotated[str, Field(max_length=100)] = ""
    """Version of the performance; see `PerformanceReader.version`."""
    done: bool = False
    shape: Annotated[str, Field(max_length=200)] | None = None
    """Shape to correct, by one of `add` and `override`."""
    add: _Weight | None = None
    override: _Weight | None = None
    fade: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Length of the ease-in and of the ease-out of the correction, in frames."""
    strokes: Annotated[tuple[NoteStroke, ...], Field(max_length=10_000)] = ()

    @property
    def span(self) -> tuple[int, int]:
        """First and last frame."""
        return self.frame, self.frame if self.last is None else max(self.last, self.frame)

    @property
    def is_correction(self) -> bool:
        """Whether it holds a correction of a weight."""
        return self.shape is not None and (self.add is None) != (self.override is None)

    def sentence(self) -> str:
        """Return the note as a line of text."""
        first, last = self.span
        where = f"frame {first}" if first == last else f"frames {first}-{last}"
        words = [self.text.strip()] if self.text.strip() else []
        if self.is_correction:
            change = f"{self.add:+g}" if self.add is not None else f"= {self.override:g}"
            words.append(f"{self.shape} {change}")
        if self.strokes:
            words.append("drawn on the picture")
        author = f" ({self.author})" if self.author else ""
        return f"{where}: {'; '.join(words) or 'no text'}{author}"


class ReviewNotes(BaseModel):
    """A file of notes."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    usdface_notes: Literal[1]
    performance: Annotated[str, Field(max_length=1000)] = ""
    """Name of the performance's file."""
    take: Annotated[str, Field(max_length=1000)] = ""
    """Name of the take."""
    notes: Annotated[tuple[ReviewNote, ...], Field(max_length=100_000)]


def read_notes(path: Path) -> ReviewNotes:
    """Read the notes that a report saved."""
    given = read_json(path, LARGEST_NOTES_BYTES)
    if not isinstance(given, dict) or "usdface_notes" not in given:
        raise InputError(f"{path}: holds no notes; save them in a report of `usdface report`")
    number = given["usdface_notes"]
    if isinstance(number, int) and number > NOTES_FORMAT:
        raise InputError(
            f"{path}: has format {number}, but this version of usdface reads {NOTES_FORMAT}; "
            "update usdface"
        )
    try:
        return ReviewNotes.model_validate(given)
    except ValidationError as error:
        raise InputError(f"{path}: {validation_messages(error, Spec)}") from error
