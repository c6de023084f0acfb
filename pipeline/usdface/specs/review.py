"""Specs of review: sheet, movie, movie-join, report, faces, evaluate."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.specs.base import MovedRigSpec, OnlyWith, Positional, Spec, WeightTableSpec
from usdface.specs.paths import (
    PRIM_PATTERN,
    ChosenFrames,
    FilePath,
    Frames,
    ImageOut,
    MeasuredOut,
    ReadPath,
    Reads,
    ShownPath,
    VideoPath,
    WritePath,
    file_ending,
    frame_list,
    prim_path,
)

AUTO_CAMERA = "auto"
FRONT_CAMERA = "front"

CameraName = Annotated[
    str,
    Field(
        pattern=f"^(auto|front|{PRIM_PATTERN})$",
        max_length=1000,
        examples=["auto", "front", "/Shot/Cameras/main"],
    ),
    AfterValidator(prim_path),
]
"""``auto`` or ``front``, which frame the face, or the prim path of a camera."""


class ShotSpec(MovedRigSpec):
    """Options common to `sheet`, `movie` and `report`."""

    only_with: ClassVar[OnlyWith] = {"camera_stage": ("camera", ())}
    traces = ("performance",)

    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ShownPath | None = None
    """The take it was made from. Default: the one its provenance names."""
    video: VideoPath | None = None
    """The take's video, if its file has moved."""
    camera: CameraName = "auto"
    """Camera of the face: `auto` frames the face, turned as the performer's head where the take has
    a video; `front` does not turn it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """Stage that holds the camera, such as a shot. Default: the performance."""


SheetLayout = Literal["comparison", "worst", "strip", "characters"]
FramePick = Literal["expression", "review", "residual", "uncertainty", "jump", "even"]


class SheetSpec(ShotSpec, WeightTableSpec):
    """Draw a contact sheet of a performance.

    It begins with a verdict. Layouts: `comparison` shows the video, the markers on the solve, the
    baseline (the blendshape equation of Deng et al. 2006, eq. 7, as `map --baseline` solves it),
    the solve, and its error against the keys or else its uncertainty; `worst`, the moments to
    review first; `strip`, an overview of the whole shot; `characters`, several performances of the
    same take.
    """

    example = (
        "usdface sheet kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.sheet.jpg"
    )
    module = "review.sheet"
    cores = 2
    memory_mib = 4096
    only_with: ClassVar[OnlyWith] = {
        **ShotSpec.only_with,
        "baseline": ("layout", ("comparison", "worst")),
        "difference": ("layout", ("comparison", "worst")),
        "weight_unit": ("against", ()),
    }

    step: Literal["sheet"] = "sheet"
    out: ImageOut
    """Picture to write: .jpg, .png or .exr. Further pages are NAME.2.jpg and so on."""
    layout: SheetLayout = "comparison"
    """Columns of the sheet; see above."""
    also: tuple[ReadPath, ...] = ()
    """More performances of the same take, on this or other rigs: one column each."""
    pick: FramePick | None = None
    """How frames are chosen: `expression`, strongest expressions and some moments to review;
    `review`, the moments to review first; by largest `residual`, `uncertainty`, or `jump` between
    frames; or `even`, at equal intervals. Default: by layout."""
    rows: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Number of frames. Default: 12, or 48 for a strip."""
    page_rows: Annotated[int, Field(ge=1, le=400)] = 100
    """Rows per page."""
    frames: ChosenFrames | None = None
    """Choose from these frames only, as FIRST-LAST; or draw these, as 1,434,1182."""
    against: ReadPath | None = None
    """Keys or other known weights to compare with (.csv, .json or .usd). Errors are measured
    against them."""
    phones: ReadPath | None = None
    """Phone labels (`usdface phones`). Rows are labelled with phone and viseme."""
    tile: Annotated[int, Field(ge=64, le=2048)] | None = None
    """Height of an image in pixels. Default: 320, or 192 for a strip."""
    quality: Literal["draft", "final"] = "final"
    """`draft` omits soft shadows and ambient occlusion."""
    baseline: bool = True
    """Draw the baseline, in layouts that have it."""
    difference: bool = True
    """Draw the error against the keys, or the uncertainty, in layouts that have it."""
    view: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """View of the OpenColorIO configuration ($OCIO, otherwise the built-in one) for the renders, as
    VIEW or DISPLAY/VIEW. Default: sRGB."""

    @model_validator(mode="after")
    def _listed_frames_are_not_chosen(self) -> Self:
        for name in ("rows", "pick"):
            if frame_list(self.frames) is not None and self.is_given(name):
                raise ValueError(f"--{name} has no effect with listed --frames; leave it out")
        return self


MOVIE_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm")

PanelKind = Literal["video", "markers", "performance"]

MovieOut = Annotated[WritePath, AfterValidator(file_ending(MOVIE_SUFFIXES, "a movie"))]


class MovieSpec(ShotSpec):
    """Make a review movie: video and performance side by side, with sound and timecode.

    Every frame is a key frame, so that players can scrub. An interrupted run is resumed.
    """

    example = (
        "usdface movie kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.review.mp4"
    )
    module = "review.movie"
    makes = "movie"
    cores = 4
    memory_mib = 8192

    step: Literal["movie"] = "movie"
    out: MovieOut
    """Movie to write: .mp4, .mov, .mkv or .webm."""
    frames: Frames | None = None
    """Frames of the take to draw, as FIRST-LAST, such as one part for `movie-join`. Default:
    all."""
    panels: Annotated[tuple[PanelKind, ...], Field(min_length=1, max_length=3)] | None = None
    """Panels from left to right: `video`, `markers`, `performance`. Default: video, if there is
    one, and performance."""
    rate: Annotated[float, Field(ge=0.01, le=240)] | None = None
    """Frames per second. Default: the video's rate, otherwise the take's, halved until it is at
    most 60."""
    height: Annotated[int, Field(ge=64, le=2160)] = 540
    """Height of the panels in pixels."""
    quality: Literal["draft", "final"] = "draft"
    """`final` adds soft shadows and ambient occlusion, and takes ten times as long."""
    workers: Annotated[int, Field(ge=0, le=256)] = 0
    """Number of rendering processes. Default: the number of cores."""
    sound: bool = True
    """Include the take's sound."""


class MovieJoinSpec(Spec):
    """Join movie parts (`usdface movie --frames`) without encoding them again.

    The sound is encoded from the take, without seams.
    """

    example = (
        "usdface movie-join a.mp4 b.mp4 --take kitchen.clean.take.usda --out kitchen.review.mp4"
    )
    module = "review.movie_join"
    makes = "movie"

    step: Literal["movie-join"] = "movie-join"
    parts: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(), Positional()]
    """Movie parts, in order."""
    take: ShownPath | None = None
    """Take whose sound is included. Without it the movie is silent."""
    out: MovieOut
    """Movie to write, in the same container format as the parts."""


PAGE_SUFFIXES = (".html", ".htm")


class ReportSpec(ShotSpec, WeightTableSpec):
    """Write an HTML report of a performance that opens from disk, offline.

    The face plays in 3D, synchronised with the video. The report shows the curves of every shape,
    uncertainty and residual, the frames to check first, repaired samples, and provenance.
    """

    example = "usdface report kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.html"
    module = "review.report"
    only_with: ClassVar[OnlyWith] = {**ShotSpec.only_with, "weight_unit": ("against", ())}

    step: Literal["report"] = "report"
    out: Annotated[WritePath, AfterValidator(file_ending(PAGE_SUFFIXES, "a page"))]
    """Report to write: .html."""
    frames: Frames | None = None
    """Frames to show, as FIRST-LAST. Default: all."""
    against: ReadPath | None = None
    """Keys or other known weights (.csv, .json or .usd). The report shows the error against
    them."""
    phones: ReadPath | None = None
    """Phone labels (`usdface phones`). The report shows phone and viseme."""
    also: Annotated[tuple[Path, ...], Field(max_length=4), Reads()] = ()
    """More performances of the same take on the same rig, such as an earlier version: their curves,
    and faces to compare with."""
    notes: Annotated[tuple[Path, ...], Reads()] = ()
    """Files of notes saved by reports. Notes on another version are marked as such. Default:
    NAME.notes.json next to the performance, if there is one."""
    sheet: ReadPath | None = None
    """Contact sheet to embed (.jpg or .png)."""
    references: ReadPath | None = None
    """References whose coverage is shown. Default: those the mapping was trained on, if their file
    still exists."""
    baseline: bool = True
    """Draw the curves of the baseline as well."""
    height: Annotated[int, Field(ge=120, le=1080)] = 360
    """Largest height of the video in the report, in pixels."""
    worst: Annotated[int, Field(ge=1, le=100)] = 12
    """Length of the list of frames to check first."""


class FacesSpec(Spec):
    """Draw performances of several characters side by side, at the same frames.

    Use it to compare retargeted or warped performances with their source. Faces are posed by USD,
    with shapes and joints; the frames are those that differ most.
    """

    example = (
        "usdface faces kitchen.human.usda kitchen.dog.usda kitchen.warped.usda "
        "--out kitchen.faces.jpg"
    )
    module = "review.faces"

    step: Literal["faces"] = "faces"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances: one column each."""
    rig: Annotated[tuple[Path, ...], Reads()] = ()
    """The rigs, if their files have moved: one per performance, in order, or one for all."""
    out: ImageOut
    """Picture to write: .jpg, .png or .exr."""
    rows: Annotated[int, Field(ge=1, le=100)] = 6
    """Number of frames."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 320
    """Height of an image in pixels."""
    yaw: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    """Angle of the view around the vertical axis, in degrees; 0 is the front."""
    quality: Literal["final", "draft"] = "final"
    """`draft` omits soft shadows and ambient occlusion."""


VerdictLevel = Literal["good", "check", "bad"]
"""Levels of a verdict: Good, Check, Do not use."""


class EvaluateSpec(MovedRigSpec, WeightTableSpec):
    """Measure the error of a performance against keys or another performance.

    Measures, for the whole face, per region and per shape: the error of the surface in mm, the
    error of the weights, the error of the lip distance, the error of blinks at their peaks, and
    jitter. Gaze and tongue, which markers cannot show, are reported separately; the JSON's
    `vertex_*` include them. Shapes only: joints and attributes are not measured.
    """

    example = "usdface evaluate kitchen.hero.usda --against animator.csv --out kitchen.error.json"
    module = "review.evaluate"

    step: Literal["evaluate"] = "evaluate"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to measure."""
    against: ReadPath
    """Keys or another performance: .csv or .json (a `frame` column, then one column per shape), or
    .usd with an animation."""
    out: MeasuredOut = ()
    """Files to write: .json for the figures, .png or .jpg for the curves. May be given twice."""
    frames: Frames | None = None
    """Frames to measure, as FIRST-LAST. Default: all."""
