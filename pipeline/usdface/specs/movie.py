"""What `usdface movie` and `usdface movie-join` are told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from usdface.specs.base import FilePath, Frames, Positional, ReadPath, Reads, Spec, WritePath
from usdface.specs.camera import CameraName

MOVIE_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm")

Panel = Literal["video", "markers", "performance"]


def _movie(path: Path) -> Path:
    if path.suffix.lower() not in MOVIE_SUFFIXES:
        raise ValueError(f"a movie is written, so the name must end in {', '.join(MOVIE_SUFFIXES)}")
    return path


MovieOut = Annotated[WritePath, AfterValidator(_movie)]


class MovieSpec(Spec):
    """Make a review movie: video and result side by side, with sound and timecode.

    Every frame is a key frame, so that it scrubs. An interrupted run goes on where it stopped.
    """

    example: ClassVar[str] = (
        "usdface movie kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.review.mp4"
    )

    step: Literal["movie"] = "movie"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ReadPath
    """The cleaned take it was mapped from."""
    out: MovieOut
    """The movie: .mp4, .mov, .mkv or .webm."""
    frames: Frames | None = None
    """Show these frames of the take only, as FIRST-LAST: a part for `movie-join`, say."""
    panels: Annotated[tuple[Panel, ...], Field(min_length=1, max_length=3)] | None = None
    """What stands side by side; video, where there is one, and performance by default."""
    rate: Annotated[float, Field(gt=0, le=240)] | None = None
    """Frames per second; the video's by default, else the take's, halved until it is at most 60."""
    height: Annotated[int, Field(ge=64, le=2160)] = 540
    """Height of the pictures in pixels."""
    quality: Literal["draft", "final"] = "draft"
    """Final has soft shadows and occlusion and takes ten times as long."""
    workers: Annotated[int, Field(ge=0, le=256)] = 0
    """Processes that draw; as many as there are cores by default."""
    camera: CameraName = "auto"
    """What the face is drawn by: `auto` frames it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """The stage that holds the camera, a shot say; the performance's own by default."""
    sound: bool = True
    """Put the take's sound in."""


class MovieJoinSpec(Spec):
    """Join parts that `usdface movie --frames` made, without encoding them again.

    The sound is put in anew from the take, so that it has no seams.
    """

    example: ClassVar[str] = (
        "usdface movie-join a.mp4 b.mp4 --take kitchen.clean.take.usda --out kitchen.review.mp4"
    )

    step: Literal["movie-join"] = "movie-join"
    parts: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(), Positional()]
    """The parts, in order."""
    take: ReadPath | None = None
    """The take whose sound goes in; without it the movie is silent."""
    out: MovieOut
    """The movie, of the same kind as the parts."""
