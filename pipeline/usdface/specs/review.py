"""Specs of review: sheet, movie, movie-join, report, faces, evaluate."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from usdface.specs.base import (
    PRIM_PATTERN,
    FilePath,
    Frames,
    ImageOut,
    Name,
    Positional,
    ReadPath,
    Reads,
    Spec,
    WritePath,
    prim_path,
)
from usdface.specs.paths import MeasuredOut

AUTO = "auto"

CameraName = Annotated[
    str,
    Field(
        pattern=f"^(auto|{PRIM_PATTERN})$",
        max_length=1000,
        examples=["auto", "/Shot/Cameras/main"],
    ),
    AfterValidator(prim_path),
]
"""``auto``, which frames the face, or the path of a camera."""


SheetLayout = Literal["comparison", "worst", "strip", "characters"]
FramePick = Literal["expression", "residual", "confidence", "jump", "even"]


class SheetSpec(Spec):
    """Draw a contact sheet to judge a performance by.

    Layouts: `comparison` (video, markers, the equation-solving baseline of Deng et al. 2006, eq. 7,
    the performance, and how far it lies from the baseline or the truth), `worst` (frames to look
    at first), `strip` (the whole shot at a glance), `characters` (several from one source).
    """

    example: ClassVar[str] = (
        "usdface sheet kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.sheet.jpg"
    )
    module: ClassVar[str] = "review.sheet"

    step: Literal["sheet"] = "sheet"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ReadPath
    """The cleaned take it was mapped from."""
    out: ImageOut
    """The picture: .jpg, .png or .exr; further pages are NAME.2.jpg and so on."""
    layout: SheetLayout = "comparison"
    """What stands side by side."""
    also: tuple[ReadPath, ...] = ()
    """More performances of the same take, on this or other rigs, each a column."""
    pick: FramePick | None = None
    """How frames are chosen: strongest expressions and the worst, by residual, by confidence, by
    jumps between frames, or evenly; by layout if not said."""
    rows: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """How many frames to show: 12, for a strip 48."""
    page_rows: Annotated[int, Field(ge=1, le=400)] = 100
    """Rows on one page."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    against: ReadPath | None = None
    """What the weights should have been (.csv, .json or .usd): errors are measured against it."""
    phones: ReadPath | None = None
    """What is said when (`usdface phones`): rows are labelled with phone and viseme."""
    tile: Annotated[int, Field(ge=64, le=2048)] | None = None
    """Height of a picture in pixels: 320, for a strip 192."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves out soft shadows and occlusion."""
    baseline: bool = True
    """Show the equation-solving baseline, where the layout has it."""
    difference: bool = True
    """Show where the performance differs from truth or baseline, where the layout has it."""
    camera: CameraName = "auto"
    """What the face is drawn by: `auto` frames it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """The stage that holds the camera, a shot say; the performance's own by default."""
    view: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """View of the OpenColorIO configuration ($OCIO, else the built-in one) to show renders by, as
    VIEW or DISPLAY/VIEW; plain sRGB by default."""


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
    module: ClassVar[str] = "review.movie"

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
    module: ClassVar[str] = "review.movie_join"

    step: Literal["movie-join"] = "movie-join"
    parts: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(), Positional()]
    """The parts, in order."""
    take: ReadPath | None = None
    """The take whose sound goes in; without it the movie is silent."""
    out: MovieOut
    """The movie, of the same kind as the parts."""


PAGE_SUFFIXES = (".html", ".htm")


def _page(path: Path) -> Path:
    if path.suffix.lower() not in PAGE_SUFFIXES:
        raise ValueError(f"a page is written, so the name must end in {', '.join(PAGE_SUFFIXES)}")
    return path


class ReportSpec(Spec):
    """Make one HTML file to judge a performance by; it opens from disk, without a network.

    The face turns and plays in the page, in step with the video; curves of every shape, where the
    result is doubtful, what was repaired and where all of it came from.
    """

    example: ClassVar[str] = (
        "usdface report kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.html"
    )
    module: ClassVar[str] = "review.report"

    step: Literal["report"] = "report"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ReadPath
    """The cleaned take it was mapped from."""
    out: Annotated[WritePath, AfterValidator(_page)]
    """The page: .html."""
    frames: Frames | None = None
    """Show these frames only, as FIRST-LAST."""
    against: ReadPath | None = None
    """What the weights should have been (.csv, .json or .usd): the page tells the errors."""
    phones: ReadPath | None = None
    """What is said when in this take (`usdface phones`): the page tells phone and viseme."""
    sheet: ReadPath | None = None
    """A contact sheet to put into the page (.jpg or .png)."""
    references: ReadPath | None = None
    """References to tell the coverage of; those that the mapping was trained on by default, where
    they are still there."""
    baseline: bool = True
    """Draw the equation-solving baseline's curves too."""
    camera: CameraName = "auto"
    """What the face is first seen by: `auto` frames it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """The stage that holds the camera, a shot say; the performance's own by default."""
    height: Annotated[int, Field(ge=120, le=1080)] = 360
    """Height of the video in the page, in pixels."""
    worst: Annotated[int, Field(ge=1, le=100)] = 12
    """How many frames to look at first are listed."""


class FacesSpec(Spec):
    """Draw performances of several characters side by side, at the same frames.

    For retargeting and warping: the source, its targets, before and after. Faces are drawn as USD
    poses them, shapes and joints together; the frames are those that differ most.
    """

    example: ClassVar[str] = (
        "usdface faces kitchen.human.usda kitchen.dog.usda kitchen.warped.usda "
        "--out kitchen.faces.jpg"
    )
    module: ClassVar[str] = "review.faces"

    step: Literal["faces"] = "faces"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances, each a column."""
    out: ImageOut
    """The sheet to write."""
    rows: Annotated[int, Field(ge=1, le=100)] = 6
    """How many frames."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 320
    """Height of a face [pixels]."""
    yaw: Annotated[float, Field(ge=-90.0, le=90.0)] = 20.0
    """How far the faces are seen from the side [degrees]."""
    quality: Literal["final", "draft"] = "final"
    """How carefully faces are drawn."""


Limit = Annotated[float, Field(ge=0.0)]


class EvaluateSpec(Spec):
    """Measure a performance against what it should have been, or against another performance.

    Weights over the shapes that markers can show; the surface and the distance of the lips in mm;
    blinks at their peaks; jitter. For the whole face, by region and by shape. Beyond a limit the
    exit code is 1: a farm can stand guard over a publish.
    """

    example: ClassVar[str] = (
        "usdface evaluate kitchen.hero.usda --against animator.csv --out kitchen.error.json "
        "--max-vertex-rms 0.5"
    )
    module: ClassVar[str] = "review.evaluate"

    step: Literal["evaluate"] = "evaluate"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to measure."""
    against: ReadPath
    """The truth, or another performance: .csv or .json (a `frame` column, then one per shape), or
    .usd with an animation."""
    out: MeasuredOut = ()
    """Where to write: .json for the figures, .png or .jpg for the curves; may be given twice."""
    frames: Frames | None = None
    """Measure these frames only, as FIRST-LAST."""
    unobservable: tuple[Name, ...] = ("eyeLook*",)
    """Shapes that markers cannot show, left out of the weights' error; * stands for anything."""
    max_weight_rmse: Limit | None = None
    """Most error of the weights."""
    max_vertex_rms: Limit | None = None
    """Most error of the surface, root mean square [mm]."""
    max_vertex_p95: Limit | None = None
    """Most error of the surface in 95 of 100 frames [mm]."""
    max_lip_error: Limit | None = None
    """Most error of the distance of the lips, root mean square [mm]."""
    max_blink_bias: Limit | None = None
    """Most that blinks may be off at their peaks, either way."""
    max_jitter: Limit | None = None
    """Most roughness; 1 is that of the truth."""
