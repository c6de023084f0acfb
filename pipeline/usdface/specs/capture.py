"""Specs of capture: ingest, track, align, clean, phones."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.core.sidecars import samples_path
from usdface.specs.base import (
    Axis,
    Name,
    NeverWith,
    OnlyWith,
    Positional,
    Spec,
    Units,
    WeightTableSpec,
)
from usdface.specs.paths import (
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    PrimPath,
    ReadPath,
    Reads,
    VideoPath,
    WritePath,
    file_ending,
)


class IngestSpec(WeightTableSpec):
    """Convert capture files to a USD take.

    Formats are recognised by content: C3D, TRC, Vicon, Motive, Live Link Face, Face Cap,
    iFacialMocap and OpenFace; tables of weights as CSV, JSON (Audio2Face, MediaPipe) or NumPy; USD
    with markers as Points, Skeleton joints or Xforms, and weights as SkelAnimation. Several files
    of one take, such as markers and Live Link, are merged. Data that is dropped or assumed is
    listed in the output. Given a folder, with a folder as --out, every take in it is ingested;
    files with the same stem form one take.
    """

    example = "usdface ingest kitchen.c3d --out kitchen.take.usda --video kitchen.mov --neutral 120"
    module = "capture.ingest"
    sidecars = (samples_path,)
    only_with: ClassVar[OnlyWith] = {"video_offset": ("video", ()), "video_rate": ("video", ())}
    never_with: ClassVar[NeverWith] = {"audio_channel": ("audio",)}

    step: Literal["ingest"] = "ingest"
    sources: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()] = ()
    """Capture files of one take, or a folder of takes."""
    out: LayerOut
    """Take to write. The samples of a .usda take are stored in a .usdc next to it."""
    video: VideoPath | None = None
    """Video of the take: a movie, or one image of a numbered sequence. The take refers to it."""
    video_rate: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Frames per second of an image sequence, which does not store its rate."""
    video_offset: float = 0.0
    """Capture time at which the video starts, in seconds. Negative: the camera started first."""
    audio: ReadPath | None = None
    """Sound recorded with the capture. The take refers to it."""
    audio_channel: Name | None = None
    """Analog channel of a C3D that holds the sound, written to a WAV file next to the take.
    Default: the channel whose name suggests sound."""
    format: Name | None = None
    """Format of the capture, if it is not recognised by content."""
    units: Units | None = None
    """Length unit of the capture, if the file does not state it or states it wrongly."""
    scale: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Factor on all lengths, in addition to --units, for captures in other units. A face in units
    of 0.1 m needs `--scale 100`."""
    up: Axis | None = None
    """Up axis of the capture, if the file does not state it or states it wrongly."""
    mirrored: Literal["labels", "axes", "no"] | None = None
    """Correction of a capture with left and right exchanged: `labels` exchanges the names of left
    and right, `axes` reflects the positions (exports with left-handed axes), `no` changes
    nothing."""
    rate: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Frames per second of markers or of a table of weights, if the file does not state it or
    states it wrongly. Tables without a column of times need it. Recordings of phones: 59.94 is
    accepted where the clock counts to 60."""
    shapes: ReadPath | None = None
    """Names of the columns of a .npy matrix of weights: a text file with one per line, a JSON list
    or .npy. Default: NAME.names.txt, .json or .npy next to the matrix."""
    frames: Frames | None = None
    """Frames to keep, first and last, such as `800-1714`, without the padding of a take. Timecode
    and video stay synchronised."""
    partial: bool = False
    """The markers cover only a part of the face on purpose, such as one side."""
    only: Name | None = None
    """For a folder: captures to read, by the ending or a pattern of their names, such as `c3d` or
    `*_v2.csv`."""
    rigid: tuple[Name, ...] = ()
    """Labels of the markers that move with the skull only."""
    neutral: int | None = None
    """Frame number of the neutral face."""
    prim: PrimPath | None = None
    """Prim that holds the markers, if a USD source has several marker sets."""
    take: Name | None = None
    """Name of the take. Default: the name of the file. For a table of several takes: the take to
    read."""
    performer: str = ""
    """Name of the performer."""
    session: str = ""
    """Name of the session in which the markers were applied, such as a date. Takes of one session
    are not compared for markers that were applied again."""
    emotion: str = ""
    """Emotion of the whole take, if it has one."""
    timecode: Annotated[str, Field(pattern=r"^(\d\d:\d\d:\d\d[:;]\d\d)?$")] = ""
    """SMPTE timecode of the first frame. Default: that of the file."""

    @model_validator(mode="after")
    def _sources_are_named(self) -> Self:
        if not self.sources:
            way = "name the capture file of the take, as in `usdface ingest kitchen.c3d`"
            if self.video is not None:
                way = (
                    "a video alone holds no markers: track the face in it with `usdface track "
                    f"{self.video} --out {self.out}`, or name the capture recorded with it"
                )
            raise ValueError(f"no sources are given: {way}")
        return self

    @model_validator(mode="after")
    def _sound_starts_with_the_capture(self) -> Self:
        if self.audio is not None and self.frames is not None:
            raise ValueError(
                "frames is given with audio, whose sound would start too early; cut the sound to "
                "the same start and ingest the take in one piece, or leave out one of them"
            )
        return self


def _distortion_terms(terms: tuple[float, ...]) -> tuple[float, ...]:
    if len(terms) not in (0, 2, 4, 5):
        raise ValueError(
            f"{len(terms)} numbers are given; OpenCV's model has k1,k2, then p1,p2, then k3: give "
            "2, 4 or 5 (models of 8 or more, and of fisheye lenses, are not supported)"
        )
    return terms


_ONLY_OF_TAKES = (
    *("parts", "calibration", "cameras", "face", "eye_distance", "neutral", "take"),
    *("performer", "session", "emotion"),
)
"""Options of a take, without effect on a part of a video."""


class TrackSpec(Spec):
    """Track a face in a video; the landmarks become the markers of a take.

    Needs the extra `usdface[track]` and MediaPipe's model face_landmarker.task, which usdface does
    not download. Each picture is analysed separately, at its exact time. Landmarks are converted to
    positions in mm: perspective is undone, and the distance between the eyes sets the scale.
    Pictures without a face are gaps. The model's scores of ARKit's shapes become weights of the
    take. Clean the take next, as for optical markers.
    """

    example = "usdface track kitchen.mp4 --out kitchen.take.usda --model face_landmarker.task"
    module = "capture.track"
    sidecars = (samples_path,)
    never_with: ClassVar[NeverWith] = {
        **dict.fromkeys(_ONLY_OF_TAKES, ("part",)),
        "views": ("part", "parts"),
        "focal_length": ("part", "calibration"),
        "distortion": ("part", "calibration"),
    }
    only_with: ClassVar[OnlyWith] = {"views": ("calibration", ()), "cameras": ("calibration", ())}

    step: Literal["track"] = "track"
    video: Annotated[VideoPath, Positional()]
    """Movie, or one image of a numbered sequence. The take refers to it, and to its sound."""
    out: LayerOut
    """Take to write. The samples of a .usda take are stored in a .usdc next to it."""
    model: ReadPath | None = None
    """MediaPipe's model, face_landmarker.task (3.8 MB, Apache 2.0). Default: the file that the
    environment variable USDFACE_FACE_MODEL names."""
    frames: Frames | None = None
    """Frames of the video to track, first and last, counted from 1 at the take's rate."""
    part: bool = False
    """Write the model's detections in the pictures of --frames instead of a take, for example on a
    farm; `track --parts` makes the take from such parts."""
    parts: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads()] | None = None
    """Parts of this video, written with --part: their pictures are not analysed again, and the
    take is the same as without. The model is needed for pictures that no part holds."""
    face: Literal["largest", "left", "right"] | None = None
    """Face to track if a picture shows several, left and right as seen in the picture. Default:
    several faces are refused."""
    quality: Literal["draft", "final"] = "final"
    """`final` analyses each picture and its mirror image, at half the speed: less noise, and lower
    confidence where the two differ."""
    focal_length: Annotated[float, Field(ge=8, le=2000)] | None = None
    """35 mm equivalent focal length of the lens, as phones state it (26 for the main camera of
    most). Default: as stated in the file, else 28."""
    distortion: Annotated[
        tuple[Annotated[float, Field(ge=-100, le=100)], ...], AfterValidator(_distortion_terms)
    ] = ()
    """Distortion of the lens as OpenCV writes it, `k1,k2`, `k1,k2,p1,p2` or `k1,k2,p1,p2,k3`:
    landmarks are undistorted before perspective is undone. Take it, and the focal length, from a
    calibration of the same lens at the same zoom. Default: none."""
    views: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(sequence=True)] | None = None
    """Videos of the same performance by further cameras, which start at the same time as the first:
    landmarks are triangulated, weighted by the confidence of each view. With --calibration."""
    calibration: ReadPath | None = None
    """Lenses and positions of the cameras: TOML of caliscope (camera_array.toml) or anipose, or the
    same as JSON."""
    cameras: tuple[Name, ...] = ()
    """Names of the cameras in --calibration, in the order of the videos, the first video first.
    Default: the order of the file."""
    eye_distance: Annotated[float, Field(ge=30, le=90)] = 63.0
    """Distance between the performer's pupils in mm, which sets the scale. The default is an
    adult's mean; nine of ten adults have 57 to 70."""
    video_rate: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Frames per second of an image sequence; of a movie of variable rate, the rate of the take."""
    neutral: int | None = None
    """Frame number of the neutral face. Default: the frame with the least expression by the model's
    scores."""
    take: Name | None = None
    """Name of the take. Default: the name of the file."""
    performer: str = ""
    """Name of the performer."""
    session: str = ""
    """Name of the recording session, such as a date."""
    emotion: str = ""
    """Emotion of the whole take, if it has one."""

    def part_spec(self, frames: str | None, out: Path) -> "TrackSpec":
        """Return the spec of a part with some of the frames."""
        others = {name: getattr(self, name) for name in ("video", "model", "quality", "video_rate")}
        return TrackSpec(**others, frames=frames, out=out, part=True)


LONGEST_SHIFT = 86400.0
"""Seconds: a day, the range of timecode."""


class AlignSpec(Spec):
    """Find the time offset and clock drift between video and capture.

    The offset is measured from the sound recorded with the capture and the camera's sound. If both
    carry timecode, it is taken from the timecode and checked against the sound. The result has a
    confidence, and a picture of the evidence is drawn; if the confidence is too low, the result is
    refused. Only the take's video settings are changed, in place.
    """

    example = "usdface align kitchen.take.usda"
    module = "capture.align"
    memory_mib = 4096
    only_with: ClassVar[OnlyWith] = {"drift": ("offset", ())}
    never_with: ClassVar[NeverWith] = {"by": ("offset",)}

    step: Literal["align"] = "align"
    take: Annotated[FilePath, Reads(assets=True), Positional()]
    """The take, with a video and the sound of the capture (`usdface ingest --video --audio`)."""
    offset: Annotated[float, Field(ge=-LONGEST_SHIFT, le=LONGEST_SHIFT)] | None = None
    """Offset set by hand: take time at which the video starts, in seconds. Negative: before the
    take."""
    drift: Annotated[float, Field(ge=-2000.0, le=2000.0)] | None = None
    """With --offset: drift of the camera's clock in parts per million, positive if it is slow.
    Default: 0."""
    by: Literal["auto", "sound", "timecode"] = "auto"
    """Source of the offset. `auto` uses timecode if both have it and the sound does not contradict
    it, otherwise sound."""
    picture: ImageOut | None = None
    """Picture of the evidence to write. Default: next to the take."""

    def picture_path(self) -> Path:
        """Return where the picture goes."""
        return self.picture or self.take.with_name(f"{self.take.stem}.align.png")

    def outputs(self) -> tuple[Path, ...]:
        """Return the picture, which is written after the take has been aligned."""
        return (self.picture_path(),)

    def changes(self) -> tuple[Path, ...]:
        """Return the picture and the take."""
        return (*self.outputs(), self.take)


class CleanSpec(Spec):
    """Remove head motion, correct labels, fill gaps and reduce noise.

    The head motion is stored as HeadMotion. The result is a stronger layer over the take, which
    does not change. Filled and relabelled samples and replaced outliers have a lower confidence.
    """

    example = "usdface clean kitchen.take.usda --out kitchen.clean.take.usda"
    module = "capture.clean"
    sidecars = (samples_path,)
    cores = 2
    memory_mib = 4096

    step: Literal["clean"] = "clean"
    take: Annotated[FilePath, Reads(), Positional()]
    """The take to clean."""
    out: LayerOut
    """The cleaned take to write."""
    rigid: tuple[Name, ...] = ()
    """Markers that move with the skull only. Default: those of the take; otherwise those labelled
    as on a head band (head, band, cap) or on no part of the face, if their distances are constant;
    otherwise, if labels name parts, all markers, weighted by their rigidity; or detected."""
    neutral: int | None = None
    """Frame number of the neutral face. Default: that of the take."""
    max_gap: Annotated[int, Field(ge=0)] | None = None
    """Longest gap to fill, in frames. Default: 2 seconds. Longer gaps keep confidence 0."""
    relabel: bool = True
    """Correct swapped labels and mistracked markers; not of landmarks, which a model names."""
    smooth: bool = True
    """Reduce noise, by the level measured in the take. The height of blinks is preserved."""


_PHONE_SUFFIXES = (".textgrid", ".json")


class PhonesSpec(Spec):
    """Find the start and end of each spoken phone, from sound and transcript.

    The words of the transcript are aligned to the sound; a transcript that does not match the sound
    is refused. Words missing from the dictionary are pronounced by letter-to-sound rules and
    listed. English only; works offline.
    """

    example = "usdface phones kitchen.wav --transcript kitchen.txt --out kitchen.TextGrid"
    module = "capture.phones"
    never_with: ClassVar[NeverWith] = {"text": ("transcript",)}

    step: Literal["phones"] = "phones"
    audio: Annotated[FilePath, Reads(), Positional()]
    """Sound file, movie or take. The phones of a take have take times, even if its sound is that of
    the camera."""
    transcript: ReadPath | None = None
    """Text file with the spoken words. Remarks in brackets are ignored."""
    text: Annotated[str, Field(min_length=1)] | None = None
    """The spoken words, instead of a file."""
    out: Annotated[WritePath, AfterValidator(file_ending(_PHONE_SUFFIXES, "a file of phones"))]
    """Phones to write: .TextGrid (Praat) or .json."""
    dictionary: ReadPath | None = None
    """Pronunciation of names and rare words: one per line, such as `kvothe K V OW TH`."""

    @model_validator(mode="after")
    def _has_a_transcript(self) -> Self:
        if self.transcript is None and self.text is None:
            raise ValueError(
                "no transcript is given: give a text file of the spoken words with "
                "--transcript, or the words with --text"
            )
        return self
