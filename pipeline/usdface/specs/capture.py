"""Specs of capture: ingest, align, clean, phones."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.specs.base import (
    Axis,
    FilePath,
    ImageOut,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
    Units,
    WritePath,
)


class IngestSpec(Spec):
    """Turn a capture into one USD take.

    The capture is told by its content: C3D, TRC, Vicon, Motive, Live Link Face, Face Cap,
    iFacialMocap or OpenFace, or a USD file with markers as Points, Skeleton joints or Xforms and
    weights as SkelAnimation. Several files of one moment, such as markers and Live Link, join.
    What was dropped or assumed is said. Point it at a folder, with a folder as --out, and every
    take in it is ingested; files of one stem belong together.
    """

    example: ClassVar[str] = (
        "usdface ingest kitchen.c3d --out kitchen.take.usda --video kitchen.mov --neutral 120"
    )
    module: ClassVar[str] = "capture.ingest"

    step: Literal["ingest"] = "ingest"
    sources: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Capture files of one take, or a folder of takes."""
    out: LayerOut
    """The take to write (.usda keeps its samples in a .usdc beside it)."""
    video: ReadPath | None = None
    """The camera's recording, a movie or one picture of a numbered sequence; the take refers to
    it."""
    video_rate: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Frames per second of a sequence of pictures: they do not say."""
    video_offset: float = 0.0
    """Seconds: the capture's time when the video starts (negative: the camera started first)."""
    audio: ReadPath | None = None
    """Sound recorded with the capture; the take refers to it."""
    audio_channel: Name | None = None
    """Analog channel of a C3D that holds the sound; one named like sound by default. It is
    written as a WAV file beside the take."""
    format: Name | None = None
    """The capture's format, where its content does not tell."""
    units: Units | None = None
    """Length unit of the capture, where the file is silent or wrong."""
    up: Axis | None = None
    """Up axis of the capture, where the file is silent or wrong."""
    rigid: tuple[Name, ...] = ()
    """Labels of the markers that move with the skull alone."""
    neutral: int | None = None
    """Frame number of the neutral face."""
    prim: PrimPath | None = None
    """The prim that holds the markers, where a USD source has several sets."""
    take: Name | None = None
    """Name of the take; the file's by default."""
    performer: str = ""
    """Who was recorded."""
    emotion: str = ""
    """Emotion of the whole take, where it has one."""
    timecode: Annotated[str, Field(pattern=r"^(\d\d:\d\d:\d\d[:;]\d\d)?$")] = ""
    """SMPTE timecode of the first frame; the file's own by default."""

    @model_validator(mode="after")
    def _offset_needs_video(self) -> Self:
        if self.video is None and (self.video_offset or self.video_rate is not None):
            raise ValueError("video_offset or video_rate is given without a video")
        if self.audio is not None and self.audio_channel is not None:
            raise ValueError("audio and audio_channel are both given; keep one")
        return self


LONGEST_SHIFT = 86400.0
"""A day, as timecode has."""


class AlignSpec(Spec):
    """Find where the video lies in the take: shift and clock drift, with a confidence.

    From the sound recorded with the capture and the camera's own; or from timecode, where both
    carry it, checked against the sound. A doubtful result is refused, with the reason and a
    picture of the evidence. The take is changed in place: only what it says of the video.
    """

    example: ClassVar[str] = "usdface align kitchen.take.usda"
    module: ClassVar[str] = "capture.align"

    step: Literal["align"] = "align"
    take: Annotated[FilePath, Reads(), Positional()]
    """The take, with a video and the capture's sound (`usdface ingest --video --audio`)."""
    offset: Annotated[float, Field(ge=-LONGEST_SHIFT, le=LONGEST_SHIFT)] | None = None
    """Set the shift by hand: seconds of the take at which the video starts (negative: before)."""
    drift: Annotated[float, Field(ge=-2000.0, le=2000.0)] | None = None
    """With --offset: parts per million by which the camera's clock is slow; 0 by default."""
    by: Literal["auto", "sound", "timecode"] = "auto"
    """What to believe; timecode where both have it and the sound does not contradict, else
    sound."""
    picture: ImageOut | None = None
    """Where the evidence is drawn; beside the take by default."""

    @model_validator(mode="after")
    def _drift_needs_offset(self) -> Self:
        if self.drift is not None and self.offset is None:
            raise ValueError("drift is given without an offset; give --offset too")
        if self.offset is not None and self.by != "auto":
            raise ValueError("offset sets the shift by hand, so --by has nothing to choose")
        return self

    def picture_path(self) -> Path:
        """Return where the picture goes."""
        return self.picture or self.take.with_name(f"{self.take.stem}.align.png")

    def outputs(self) -> tuple[Path, ...]:
        """Return the picture: it is drawn last, and tells that the take has been aligned."""
        return (self.picture_path(),)

    def changes(self) -> tuple[Path, ...]:
        """Return the picture, and the take."""
        return (*self.outputs(), self.take)


class CleanSpec(Spec):
    """Take head motion out, mend labels, fill gaps, remove noise.

    The head's motion is kept as HeadMotion. The result is a stronger layer over the take, which
    stays as it is. Repaired samples have a lower confidence.
    """

    example: ClassVar[str] = "usdface clean kitchen.take.usda --out kitchen.clean.take.usda"
    module: ClassVar[str] = "capture.clean"

    step: Literal["clean"] = "clean"
    take: Annotated[FilePath, Reads(), Positional()]
    """The take to clean."""
    out: LayerOut
    """The cleaned take."""
    rigid: tuple[Name, ...] = ()
    """Markers that move with the skull alone; the take's own, or found, by default."""
    neutral: int | None = None
    """Frame number of the neutral face; the take's own by default."""
    max_gap: Annotated[int, Field(ge=0)] | None = None
    """Longest gap to fill, in frames; 2 seconds by default. Longer ones keep confidence 0."""
    relabel: bool = True
    """Mend swapped labels and mistracked markers."""
    report: ImageOut | None = None
    """A picture of what was repaired, marker by marker over time."""
    smooth: bool = True
    """Remove measured noise; blinks keep their height."""


_TRACK_SUFFIXES = (".textgrid", ".lab", ".json")


def _is_track(path: Path) -> Path:
    if path.suffix.lower() not in _TRACK_SUFFIXES:
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
    module: ClassVar[str] = "capture.phones"

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
