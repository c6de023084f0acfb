"""What `usdface phones` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.specs.base import FilePath, Positional, ReadPath, Reads, Spec, WritePath

TRACK_SUFFIXES = (".textgrid", ".lab", ".json")


def _is_track(path: Path) -> Path:
    if path.suffix.lower() not in TRACK_SUFFIXES:
        raise ValueError("phones are written, so the name must end in .TextGrid, .lab or .json")
    return path


class PhonesSpec(Spec):
    """Find when each phone is said, from the sound and what is said in it.

    The words are laid along the sound; a transcript of other words is refused. Words that no
    dictionary has are guessed from their letters, and named. English, offline.
    """

    example: ClassVar[str] = (
        "usdface phones kitchen.wav --transcript kitchen.txt --out kitchen.TextGrid"
    )

    step: Literal["phones"] = "phones"
    audio: Annotated[FilePath, Reads(), Positional()]
    """Sound file or movie; or a take, whose sound is used: times are then the take's, whatever
    the camera's clock."""
    transcript: ReadPath | None = None
    """Text file with the words that are said; remarks in brackets are left out."""
    text: Annotated[str, Field(min_length=1)] | None = None
    """The words themselves, instead of a file."""
    out: Annotated[WritePath, AfterValidator(_is_track)]
    """The phones: .TextGrid for Praat, .lab for HTK, or .json."""
    dictionary: ReadPath | None = None
    """How names and other rare words are said, as in `kvothe  K V OW TH`, one a line."""

    @model_validator(mode="after")
    def _one_transcript(self) -> Self:
        if self.transcript is None and self.text is None:
            raise ValueError(
                "no transcript is given: write down what is said and give the file with "
                "--transcript, or the words with --text"
            )
        if self.transcript is not None and self.text is not None:
            raise ValueError("transcript and text are both given; keep one")
        return self
