"""What `usdface ingest` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import (
    Axis,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
    Units,
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
