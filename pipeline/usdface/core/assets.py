"""The data passed between all parts: frozen dataclasses of arrays.

Lengths are millimetres, Y is up, rates are exact fractions and frames are integers; `usdio`
converts units when it reads and writes.
"""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination, RigLogic
from usdface.core.text import first_few, pluralize

MarkerSpace = Literal["captured", "stabilized"]


class _Asset:
    """Base with a short representation: shapes of arrays and lengths of tuples."""

    def __repr__(self) -> str:
        shown = (f"{field.name}={_short(getattr(self, field.name))}" for field in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: object) -> str:
    """Return a short representation: the shape of an array, the length of a tuple."""
    if isinstance(value, np.ndarray):
        return f"<{' x '.join(map(str, value.shape))} {value.dtype}>"
    if isinstance(value, tuple) and len(value) > _SHOWN_ITEMS:
        return f"<{len(value)}: {_short(value[0])}, ...>"
    if isinstance(value, Fraction):
        return f"{float(value):g}"
    text = repr(value)
    short = len(text) <= _LONGEST_TEXT or isinstance(value, _Asset)
    return text if short else f"{text[:_LONGEST_TEXT]}..."


_SHOWN_ITEMS = 3
"""Longest tuple that is shown in full."""
_LONGEST_TEXT = 80
"""Characters of any other value."""


def _column(name: str, names: tuple[str, ...], what: str) -> int:
    """Return the index of a name; a KeyError suggests similar ones."""
    if name in names:
        return names.index(name)
    near = difflib.get_close_matches(name, names, n=3) or names
    raise KeyError(f"no {what} {name!r}; did you mean {first_few(near)}?")


MEASURED_CONFIDENCE = 0.9
"""Confidence from which a sample counts as measured: a filled one within .05 s of a measured one.
Most frames have such samples; they hardly change the uncertainty."""


@dataclass(frozen=True, repr=False)
class Markers(_Asset):
    """A cloud of named markers over the frames of a take."""

    names: tuple[str, ...]
    """One label per marker, unique."""
    positions: Float32Array
    """(frames, markers, 3) [mm], Y up. Where not visible, the last good position or, once cleaned,
    the prediction from the other markers; never NaN."""
    visible: BoolArray
    """(frames, markers): whether the capture measured the marker."""
    confidence: Float32Array
    """(frames, markers) [0-1]; 1 as measured, lower where a sample was repaired."""
    rigid: tuple[str, ...] = ()
    """Names of the markers that move with the skull alone."""
    neutral_frame: int = 0
    """Frame number (not index) of the neutral face; the reference pose of the head."""
    anchor: str = ""
    """Name of the marker nearest the head's origin, or empty."""
    space: MarkerSpace = "captured"
    """Whether positions have head motion ("captured") or not ("stabilized")."""

    @property
    def usable(self) -> BoolArray:
        """(frames, markers): where a position was measured or repaired."""
        return np.asarray(self.visible | (self.confidence > 0))

    def __getitem__(self, name: str) -> Float32Array:
        """Return the positions of one marker, (frames, 3) [mm]."""
        return self.positions[:, _column(name, self.names, "marker")]


@dataclass(frozen=True, repr=False)
class WeightsClip(_Asset):
    """Named float channels over time: a performance, or a take's own blendshape weights."""

    names: tuple[str, ...]
    """Channel names, unique."""
    values: Float32Array
    """(frames, channels): usually in [0-1]; USD does not limit them."""
    first_frame: int
    """Frame number of ``values[0]``."""
    rate: Fraction
    """Frames per second."""
    gaps: tuple[tuple[int, int], ...] = ()
    """First and last frame of each stretch without capture, in which values are interpolated."""

    def __getitem__(self, name: str) -> Float32Array:
        """Return the values of one channel, (frames,)."""
        return self.values[:, _column(name, self.names, "channel")]


Seconds = TypeVar("Seconds", float, FloatArray)


@dataclass(frozen=True)
class Video:
    """The camera's recording: take_time = offset + (1 + drift * 1e-6) * video_time."""

    file: Path
    """The movie; referred to, never copied."""
    rate: Fraction | None = None
    """Frames per second according to the file."""
    offset: float = 0.0
    drift: float = 0.0
    """`offset`, `drift`: [s], [ppm]"""

    def video_time(self, take_seconds: Seconds) -> Seconds:
        """Return times of the take [s] on the video's clock [s]."""
        return (take_seconds - self.offset) / (1.0 + self.drift * 1e-6)

    def take_time(self, video_seconds: Seconds) -> Seconds:
        """Return times of the video [s] on the take's clock [s]."""
        return self.offset + (1.0 + self.drift * 1e-6) * video_seconds


@dataclass(frozen=True)
class Event:
    """A moment marked on the capture machine; `frame` may lie between two frame numbers."""

    label: str
    frame: float


@dataclass(frozen=True, repr=False)
class Take(_Asset):
    """One continuous recording of one performer; texts are empty if unknown."""

    name: str
    rate: Fraction
    """Frames per second of the capture."""
    first_frame: int
    """Frame number of the first sample; USD time codes of the take are frame numbers."""
    markers: Markers | None = None
    source: WeightsClip | None = None
    """Blendshape weights of the capture (Live Link, another solver)."""
    head_motion: FloatArray | None = None
    """(frames, 4, 4): transforms for column vectors from stabilised to captured positions."""
    video: Video | None = None
    audio: Path | None = None
    performer: str = ""
    session: str = ""
    """Takes of one session have one application of markers."""
    emotion: str = ""
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty if unknown."""
    events: tuple[Event, ...] = ()
    """In the order of the recording."""
    warnings: tuple[str, ...] | None = None
    """Anomalies of its markers, by ingest; None if they were not examined."""

    @property
    def frame_count(self) -> int:
        """Number of frames of the take."""
        if self.markers is not None:
            return len(self.markers.positions)
        return 0 if self.source is None else len(self.source.values)

    @property
    def last_frame(self) -> int:
        """Frame number of the last sample."""
        return self.first_frame + self.frame_count - 1

    @property
    def frames(self) -> IntArray:
        """Frame numbers, one per sample."""
        return np.arange(self.first_frame, self.last_frame + 1, dtype=np.int64)

    def seconds(self, frames: Seconds) -> Seconds:
        """Return times of frames, by number, on the take's clock: 0 at its first frame [s]."""
        return (frames - self.first_frame) / float(self.rate)

    def video_seconds(self, frames: Seconds) -> Seconds:
        """Return times of frames, by number, on the clock of its video [s]."""
        if self.video is None:
            raise ValueError(f"take {self.name} has no video")
        return self.video.video_time(self.seconds(frames))


@dataclass(frozen=True, repr=False)
class ShapeKey(_Asset):
    """A target of a shape: the full one, or an in-between."""

    weight: float
    """The channel's weight at this key; 1 for the full target."""
    points: IntArray
    """(n,): indices of moved points."""
    offsets: FloatArray
    """(n, 3) [mm]"""
    normal_offsets: FloatArray | None = None
    """(n, 3)"""


@dataclass(frozen=True, repr=False)
class MeshShape(_Asset):
    """Keys of one channel on one mesh, in ascending weight, the full target at 1."""

    name: str
    keys: tuple[ShapeKey, ...]


@dataclass(frozen=True, repr=False)
class RigMesh(_Asset):
    """One mesh of a rig at rest, in the stage's world space."""

    path: str
    """Prim path."""
    points: FloatArray
    """(points, 3) [mm]"""
    face_counts: IntArray
    face_indices: IntArray
    """`face_counts`, `face_indices`: Polygons as USD stores them."""
    shapes: tuple[MeshShape, ...] = ()
    """The BlendShapes bound to this mesh, in the mesh's own order."""
    colors: FloatArray | None = None
    """(points, 3): linear display colour per point."""
    normals: FloatArray | None = None
    """(points, 3): authored point normals, if the mesh has them and they follow its points."""
    subdivision: str = "none"
    """``'none'``, ``'catmullClark'``, ``'loop'`` or ``'bilinear'``."""
    visible: bool = True
    """False if hidden or not for rendering (purpose guide or proxy)."""
    inside_out: bool = False
    """Whether polygons are clockwise seen from outside: left-handed, or mirrored by a transform."""
    face_colors: FloatArray | None = None
    """(polygons, 4): linear colour and opacity by materials; NaN without one."""
    undrawn: tuple[str, ...] = ()
    """Parts of its materials that pictures leave out."""


def point_slices(meshes: Sequence[RigMesh]) -> list[slice]:
    """Return the points of each mesh among those of all, in order."""
    ends = list(accumulate(len(mesh.points) for mesh in meshes))
    return [slice(end - len(mesh.points), end) for mesh, end in zip(meshes, ends, strict=True)]


def range_ends(ranges: FloatArray) -> FloatArray:
    """Return the end of each range that is farther from 0, where the shape is full: (shapes,)."""
    low, high = ranges.T
    return np.asarray(np.where(-low > high, low, high))


@dataclass(frozen=True, repr=False)
class Rig(_Asset):
    """A character's face: meshes with BlendShapes that named channels drive."""

    file: Path
    prim: str
    """Path of the SkelRoot."""
    shapes: tuple[str, ...]
    """Names of the animated shapes of all meshes, each once, in the order of the meshes; without
    those that `combinations` drive."""
    meshes: tuple[RigMesh, ...]
    """Lengths in mm, Y up, whatever the stage's units are."""
    ranges: FloatArray
    """(shapes, 2): lowest and highest weight; 0 to 1 unless the rig has others."""
    combinations: tuple[Combination, ...] = ()
    """Shapes that others drive, in the order of evaluation."""
    variants: tuple[tuple[str, str, str], ...] = ()
    """Prim path, variant set and variant of selections that are not the file's."""

    @property
    def ranges_of_ends(self) -> FloatArray:
        """(shapes, 2): lowest and highest weight over that of `range_ends`."""
        return np.sort(self.ranges / range_ends(self.ranges)[:, None], axis=1)

    @property
    def skin_meshes(self) -> tuple[RigMesh, ...]:
        """The visible meshes if they have half of the shapes, else all: copies may be hidden."""
        shown = tuple(mesh for mesh in self.meshes if mesh.visible)
        names = {shape.name for mesh in shown for shape in mesh.shapes}
        return shown if 2 * len(names) >= len(self.shapes) else self.meshes

    @property
    def logic(self) -> RigLogic:
        """The functions by which the animated shapes drive the combinations."""
        return RigLogic(self.shapes, self.combinations)

    def ranges_of(self, shapes: Iterable[str]) -> FloatArray:
        """Return the ranges of shapes, (shapes, 2); 0 to 1 for unknown ones."""
        ranges = dict(zip(self.shapes, self.ranges, strict=True))
        return np.array([ranges.get(name, (0.0, 1.0)) for name in shapes]).reshape(-1, 2)

    def check_has(self, shapes: Iterable[str], *, source: object, remedy: str) -> None:
        """Raise InputError if the rig lacks shapes."""
        names = list(shapes)
        missing = [name for name in names if name not in self.shapes]
        driven = self.logic.driven & set(missing)
        if driven:
            raise InputError(
                f"{source}: {first_few(sorted(driven), most=3)} of its shapes are combinations on "
                f"{self.file}, which other shapes drive; {remedy}"
            )
        if missing:
            other = missing == names and f", which has {first_few(self.shapes, most=3)}"
            raise InputError(
                f"{source}: {len(missing)} of its {pluralize(len(names), 'shape')} are not on "
                f"{self.file} ({first_few(missing, most=3)}){other or ''}; {remedy}"
            )

    def undrawn_notes(self) -> tuple[str, ...]:
        """Return a note on the parts of materials that pictures leave out, if there are any."""
        undrawn = dict.fromkeys(
            note for mesh in self.meshes if mesh.visible for note in mesh.undrawn
        )
        return (f"drawn without its textures: {first_few(undrawn, most=3)}",) if undrawn else ()


@dataclass(frozen=True, repr=False)
class MotionSpace(_Asset):
    """Motion space of a performer's face: principal components over whole takes."""

    mean: FloatArray
    """(markers * 3,) [mm]"""
    components: FloatArray
    """(dimensions, markers * 3): orthonormal rows, the largest variance first."""
    variances: FloatArray
    """(dimensions,) [mm^2]"""
    total_variance: float
    """Of all dimensions, with those left out [mm^2]."""
    sample: FloatArray
    """(frames, dimensions): coordinates of frames spread over the takes."""
    sample_starts: tuple[int, ...] = (0,)
    """Row of `sample` with the first frame of each take."""


@dataclass(frozen=True, repr=False)
class References(_Asset):
    """Frames of takes and their rig weights by an animator; pair *i* is at index *i*."""

    marker_names: tuple[str, ...]
    shape_names: tuple[str, ...]
    markers: FloatArray
    """(pairs, markers, 3): stabilised positions [mm]."""
    weights: FloatArray
    """(pairs, shapes)"""
    frames: IntArray
    """(pairs,): frame number of each pair in its take."""
    takes: tuple[str, ...]
    """Name of each pair's take."""
    tuned: BoolArray
    """(pairs,): True where a person set the weights, False where they are a proposal."""
    rigid: tuple[str, ...]
    """The markers that move with the skull alone."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face in the space of `markers` [mm]."""
    rig_file: Path
    rig_prim: str
    combinations: tuple[Combination, ...] = ()
    """Of the rig: driven shapes, which are not in `shape_names`."""
    motion: MotionSpace | None = None
    """Of the takes from which the pairs were selected; None for pairs made by hand."""
    visemes: tuple[str, ...] = ()
    emotions: tuple[str, ...] = ()
    """`visemes`, `emotions`: Of each pair; empty if unknown or none."""
    authors: tuple[str, ...] = ()
    """Author of the weights of each pair; empty if unknown."""
    performer: str = ""
    session: str = ""
    neutral_take: str = ""
    """`performer`, `session`, `neutral_take`: Of the take with this head space and neutral face;
    empty if unknown."""
    rate: float = 0.0
    """Frames per second of the first take; 0 if unknown."""
    placement: Path | None = None
    """The placement of the markers on the rig."""
    parts: tuple[str, ...] = ()
    """Evidence for the part of the face of each shape, if the rig was examined; see
    `usdface.model.placement.shape_parts`."""
    trajectories: FloatArray | None = None
    """(pairs, times, markers, 3): displacement from `markers` at times about each pair's frame, see
    `usdface.core.trajectories` [mm]; None if unknown."""
    source_names: tuple[str, ...] = ()
    source: FloatArray | None = None
    """(pairs, source names): weights in takes that have weights instead of markers, else None."""

    def weights_of(self, pair: int) -> dict[str, float]:
        """Return the weights of a pair by shape."""
        return dict(zip(self.shape_names, self.weights[pair].tolist(), strict=True))

    def rows(self, kept: IntArray | BoolArray) -> "References":
        """Return some of the pairs, by index or mask."""
        pairs = np.arange(len(self.weights))[kept]

        def named(texts: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(texts[pair] for pair in pairs) if texts else ()

        return replace(
            self,
            markers=self.markers[pairs],
            weights=self.weights[pairs],
            frames=self.frames[pairs],
            tuned=self.tuned[pairs],
            takes=named(self.takes),
            visemes=named(self.visemes),
            emotions=named(self.emotions),
            authors=named(self.authors),
            trajectories=None if self.trajectories is None else self.trajectories[pairs],
            source=None if self.source is None else self.source[pairs],
        )


@dataclass(frozen=True)
class CandidateScore:
    """Cross-validation error of one candidate."""

    method: str
    settings: str
    """`method`, `settings`: The candidate's hyper-parameters, readable."""
    weight_rmse: float
    """Root mean square error of the weights."""
    vertex_rms_mm: float
    """Root mean square error of the rig's surface [mm]; NaN without a rig."""


@dataclass(frozen=True, repr=False)
class TrainedMapping(_Asset):
    """A trained function from stabilised markers to a rig's channels."""

    method: str
    """Name of the regression, a key of `usdface.model.regressions`."""
    marker_names: tuple[str, ...]
    shape_names: tuple[str, ...]
    """`marker_names`, `shape_names`: Order of the input and of the output."""
    rigid: tuple[str, ...]
    """Markers by which takes are aligned with this mapping's head space."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]; defines that head space."""
    ranges: FloatArray
    """(shapes, 2): lowest and highest weight of each channel; predictions are limited to it."""
    arrays: dict[str, FloatArray]
    """Parameters of the regression, by name."""
    settings: dict[str, float | int | str | bool] = field(default_factory=dict)
    """Hyper-parameters, given or chosen."""
    scores: tuple[CandidateScore, ...] = ()
    """Candidates of cross-validation, best first."""
    references: str = ""
    """The references it was trained on."""


@dataclass(frozen=True)
class SolveBasis:
    """What a solve rests on: its mapping's training data, and the regions that markers show."""

    pairs: int
    """Number of references."""
    tuned: int
    """Number of references that a person has tuned."""
    still_regions: tuple[str, ...] = ()
    """Regions of the face that no reference moves."""
    regions_without_markers: tuple[str, ...] = ()
    """Regions of the face without markers."""
    changed_shapes: tuple[str, ...] = ()
    """Shapes of the rig that changed since the training."""
    regions_without_shapes: tuple[str, ...] = ()
    """Regions of the face with markers, and without shapes of the rig."""
    motion_scale: float = 1.0
    """Motion of the rig over that of the performer; 1 if unknown."""


@dataclass(frozen=True, repr=False)
class Performance(_Asset):
    """Weights over a rig, and their reliability."""

    weights: WeightsClip
    rig_file: Path
    rig_prim: str
    uncertainty_mm: FloatArray | None = None
    """(frames, regions): standard deviation of the surface about that of an animator's keys, of the
    face and its regions [mm]; of the face alone in layers of earlier versions."""
    coverage: FloatArray | None = None
    """(frames, regions): coverage of the frame by the mapping's references [0-1]."""
    residual_mm: FloatArray | None = None
    """(frames, regions): distance of the markers from their positions under the weights, less that
    at the references [mm]."""
    regions: tuple[str, ...] = ()
    basis: SolveBasis | None = None
    """None in layers of earlier versions."""
    timecode_start: str = ""
    neutral_frame: int | None = None
    """Frame of the performer's neutral face; None if the weights were not mapped from markers."""

    def __getitem__(self, name: str) -> Float32Array:
        """Return the weights of one shape, (frames,)."""
        return self.weights[name]
