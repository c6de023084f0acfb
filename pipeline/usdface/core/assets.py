"""The nouns that travel between the parts: frozen dataclasses of arrays.

Lengths are millimetres, Y is up, rates are exact fractions and frames are integers; `usdio`
converts once at the border. Nothing here reads, writes or computes.
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from fractions import Fraction
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination, RigLogic
from usdface.core.text import first_few, pluralize

MarkerSpace = Literal["captured", "stabilized"]


class _Asset:
    """Shown by what it holds, not by every number of it, and asked for its channels by name."""

    def __repr__(self) -> str:
        shown = (f"{each.name}={_short(getattr(self, each.name))}" for each in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: object) -> str:
    """Return a value as a person wants it: the shape of an array, how many of many."""
    if isinstance(value, np.ndarray):
        return f"<{' x '.join(map(str, value.shape))} {value.dtype}>"
    if isinstance(value, tuple) and len(value) > _SHOWN_ITEMS:
        return f"<{len(value)}: {_short(value[0])}, ...>"
    if isinstance(value, Fraction):
        return f"{float(value):g}"
    text = repr(value)
    return (
        text
        if len(text) <= _LONGEST_TEXT or isinstance(value, _Asset)
        else f"{text[:_LONGEST_TEXT]}..."
    )


_SHOWN_ITEMS = 3
"""Items of a tuple that are all shown."""
_LONGEST_TEXT = 80
"""Characters of any other value."""


def _column(name: str, names: tuple[str, ...], what: str) -> int:
    """Return where a name is; KeyError says which is meant perhaps."""
    if name in names:
        return names.index(name)
    near = difflib.get_close_matches(name, names, n=3) or names
    raise KeyError(f"no {what} {name!r}; did you mean {first_few(near)}?")


@dataclass(frozen=True, repr=False)
class Markers(_Asset):
    """A cloud of named markers over the frames of a take."""

    names: tuple[str, ...]
    """One label per marker, unique."""
    positions: Float32Array
    """(frames, markers, 3) [mm], Y up. A marker that is not seen keeps its last good position:
    never NaN."""
    visible: BoolArray
    """(frames, markers): false where the capture did not see the marker."""
    confidence: Float32Array
    """(frames, markers) [0-1]; 1 as measured, lower where a sample was repaired."""
    rigid: tuple[str, ...] = ()
    """Names of the markers that move with the skull alone."""
    neutral_frame: int = 0
    """Frame number (not index) of the neutral face; the reference pose of the head."""
    anchor: str = ""
    """Name of the marker nearest the head's origin; empty when there is none."""
    space: MarkerSpace = "captured"
    """Whether head motion is still in."""

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
    unseen: tuple[tuple[int, int], ...] = ()
    """First and last frame of each stretch where nothing was captured: values are interpolated."""

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
    """Frames per second as the file states it."""
    offset: float = 0.0
    drift: float = 0.0
    """`offset`, `drift`: [s], [ppm]"""

    def video_time(self, take_seconds: Seconds) -> Seconds:
        """Return moments of the take [s] on the video's clock [s]."""
        return (take_seconds - self.offset) / (1.0 + self.drift * 1e-6)

    def take_time(self, video_seconds: Seconds) -> Seconds:
        """Return moments of the video [s] on the take's clock [s]."""
        return self.offset + (1.0 + self.drift * 1e-6) * video_seconds


@dataclass(frozen=True)
class Event:
    """A moment marked on the capture machine; `frame` may lie between two frame numbers."""

    label: str
    frame: float


@dataclass(frozen=True, repr=False)
class Take(_Asset):
    """One continuous recording of one performer; texts are empty when unknown."""

    name: str
    rate: Fraction
    """Frames per second of the capture."""
    first_frame: int
    """Frame number of the first sample; a time code of the take is a frame number."""
    markers: Markers | None = None
    source: WeightsClip | None = None
    """Blendshape weights that the capture carries (Live Link, another solver)."""
    head_motion: FloatArray | None = None
    """(frames, 4, 4): Column-vector transforms that put stabilised markers back where they were
    captured."""
    video: Video | None = None
    audio: Path | None = None
    performer: str = ""
    session: str = ""
    """Takes of one session share one application of markers."""
    emotion: str = ""
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty when unknown."""
    events: tuple[Event, ...] = ()
    """In the order of the recording."""
    doubts: tuple[str, ...] | None = None
    """What is odd about its markers, as ingest saw it; None where nobody has looked."""

    @property
    def frame_count(self) -> int:
        """Number of frames of the take."""
        if self.markers is not None:
            return len(self.markers.positions)
        return 0 if self.source is None else len(self.source.values)

    @property
    def frames(self) -> IntArray:
        """Frame numbers, one per sample."""
        return np.arange(self.first_frame, self.first_frame + self.frame_count, dtype=np.int64)


@dataclass(frozen=True, repr=False)
class ShapeKey(_Asset):
    """One sculpted position of a shape: its full target, or an in-between."""

    weight: float
    """Where on the channel this key is reached; 1 for the full target."""
    points: IntArray
    """(n,): the points it moves."""
    offsets: FloatArray
    """(n, 3) [mm]"""
    normal_offsets: FloatArray | None = None
    """(n, 3)"""


@dataclass(frozen=True, repr=False)
class MeshShape(_Asset):
    """What one channel does to one mesh: keys in ascending weight, the full target at 1."""

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
    """False when hidden or not meant for rendering (purpose guide or proxy)."""
    face_colors: FloatArray | None = None
    """(polygons, 4): linear colour and opacity that materials give polygons; NaN where none
    does."""
    undrawn: tuple[str, ...] = ()
    """What of its materials pictures leave out."""


@dataclass(frozen=True, repr=False)
class Rig(_Asset):
    """A character's face: meshes whose BlendShapes answer to named channels."""

    file: Path
    prim: str
    """Path of the SkelRoot."""
    shapes: tuple[str, ...]
    """Names of the shapes that are animated, over all meshes, each once, in the order they are
    found; without those that `combinations` drive."""
    meshes: tuple[RigMesh, ...]
    """Lengths in mm, Y up, whatever the stage's units are."""
    ranges: FloatArray
    """(shapes, 2): lowest and highest weight an animator may give; 0 to 1 unless the rig says
    otherwise."""
    combinations: tuple[Combination, ...] = ()
    """Shapes that others drive, parts before what they drive."""

    @property
    def logic(self) -> RigLogic:
        """What the animated shapes make of the combinations."""
        return RigLogic(self.shapes, self.combinations)

    def ranges_of(self, shapes: Iterable[str]) -> FloatArray:
        """Return the ranges of shapes, (shapes, 2); 0 to 1 of those that the rig lacks."""
        own = dict(zip(self.shapes, self.ranges, strict=True))
        return np.array([own.get(name, (0.0, 1.0)) for name in shapes]).reshape(-1, 2)

    def check_has(self, shapes: Iterable[str], *, source: object, remedy: str) -> None:
        """Raise InputError where the rig lacks shapes."""
        names = list(shapes)
        missing = [name for name in names if name not in self.shapes]
        driven = self.logic.driven & set(missing)
        if driven:
            raise InputError(
                f"{source}: {first_few(sorted(driven), most=3)} of its shapes are combinations on "
                f"{self.file}, which other shapes drive; {remedy}"
            )
        if missing:
            raise InputError(
                f"{source}: {len(missing)} of its {pluralize(len(names), 'shape')} are not on "
                f"{self.file} ({first_few(missing, most=3)}); {remedy}"
            )

    def undrawn_notes(self) -> tuple[str, ...]:
        """Return a note on what of the materials no picture shows; empty where all is shown."""
        undrawn = dict.fromkeys(
            note for mesh in self.meshes if mesh.visible for note in mesh.undrawn
        )
        return (f"drawn without its textures: {first_few(undrawn, most=3)}",) if undrawn else ()


@dataclass(frozen=True, repr=False)
class MotionSpace(_Asset):
    """What a performer's face does, in few numbers: principal components over whole takes."""

    mean: FloatArray
    """(markers * 3,) [mm]"""
    components: FloatArray
    """(dimensions, markers * 3): orthonormal rows, the largest variance first."""
    variances: FloatArray
    """(dimensions,) [mm^2]"""
    total_variance: float
    """Of all dimensions, kept or not [mm^2]."""
    sample: FloatArray
    """(frames, dimensions): coordinates of frames spread over the takes: the motion without
    labels."""


@dataclass(frozen=True, repr=False)
class References(_Asset):
    """Frames of a take with the rig weights an animator wants there; pair *i* is at index *i*."""

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
    """(pairs,): true where a person set the weights; False where they are still a proposal."""
    rigid: tuple[str, ...]
    """The markers that move with the skull alone."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face in the space of `markers` [mm]."""
    rig_file: Path
    rig_prim: str
    combinations: tuple[Combination, ...] = ()
    """Of the rig: shapes that `shape_names` leaves out, and layers hold as these drive them."""
    motion: MotionSpace | None = None
    """Of the takes the pairs were selected from; None for pairs made by hand."""
    visemes: tuple[str, ...] = ()
    emotions: tuple[str, ...] = ()
    """`visemes`, `emotions`: Of each pair; empty where unknown, or where none is."""
    authors: tuple[str, ...] = ()
    """Who set the weights of each pair; empty where unknown."""
    performer: str = ""
    session: str = ""
    """`performer`, `session`: Of the take whose head space and neutral face these are; empty where
    unknown."""
    rate: float = 0.0
    """Frames per second of the takes, the first's where they differ; 0 where it is not known."""
    placement: Path | None = None
    """Where the markers were placed on the rig."""
    parts: tuple[str, ...] = ()
    """What tells the part of the face of each shape, where its rig was looked at; see
    `usdface.model.placement.shape_parts`."""
    source_names: tuple[str, ...] = ()
    source: FloatArray | None = None
    """(pairs, source names): weights of the takes themselves, of takes that carry weights instead
    of markers; None where there are markers."""


@dataclass(frozen=True)
class CandidateScore:
    """How well one candidate predicted references it had not seen."""

    method: str
    settings: str
    """`method`, `settings`: The candidate's hyper-parameters, readable."""
    weight_rmse: float
    """Root mean square error of the weights."""
    vertex_rms_mm: float
    """The same error as it shows on the rig's surface [mm]; NaN when no rig was given."""


@dataclass(frozen=True, repr=False)
class TrainedMapping(_Asset):
    """A trained function from stabilised markers to a rig's channels: all that predict needs."""

    method: str
    """Name of the regression, a key of `usdface.model.regressions`."""
    marker_names: tuple[str, ...]
    shape_names: tuple[str, ...]
    """`marker_names`, `shape_names`: Order of the input and of the output."""
    rigid: tuple[str, ...]
    """Markers by which another take is brought into this mapping's head space."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]; defines that head space."""
    ranges: FloatArray
    """(shapes, 2): lowest and highest weight of each channel; predictions are limited to it."""
    arrays: dict[str, FloatArray]
    """What the method learned, by name."""
    settings: dict[str, float | int | str | bool] = field(default_factory=dict)
    """Hyper-parameters, given or chosen."""
    scores: tuple[CandidateScore, ...] = ()
    """What cross-validation tried, best first."""
    references: str = ""
    """The references it was trained on."""


@dataclass(frozen=True)
class SolveBasis:
    """What a solve's mapping learnt from."""

    pairs: int
    """References."""
    tuned: int
    """Those of them that a person has tuned."""
    still_regions: tuple[str, ...] = ()
    """Regions of the face that no reference moves."""
    unseen_regions: tuple[str, ...] = ()
    """Regions of the face that no marker sees."""
    changed_shapes: tuple[str, ...] = ()
    """Shapes of the rig that are not those of the training any more."""


@dataclass(frozen=True, repr=False)
class Performance(_Asset):
    """The written result: weights over a rig, and how far they can be trusted."""

    weights: WeightsClip
    rig_file: Path
    rig_prim: str
    uncertainty_mm: FloatArray | None = None
    """(frames, regions): standard deviation of the surface around what an animator would key, of
    the face and its regions [mm]; of the face alone in layers of earlier versions."""
    coverage: FloatArray | None = None
    """(frames, regions): how far the mapping's references show what the frame does [0-1]."""
    residual_mm: FloatArray | None = None
    """(frames, regions): distance of the markers from where the weights put them, less what is
    left at the references themselves [mm]."""
    regions: tuple[str, ...] = ()
    basis: SolveBasis | None = None
    """None in layers of earlier versions."""
    timecode_start: str = ""
    neutral_frame: int | None = None
    """Frame of the take that shows the performer's neutral face; None where the weights were not
    mapped from markers."""

    def __getitem__(self, name: str) -> Float32Array:
        """Return the weights of one shape, (frames,)."""
        return self.weights[name]
