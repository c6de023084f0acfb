"""The nouns that travel between the parts: frozen dataclasses of arrays.

Lengths are millimetres, Y is up, rates are exact fractions and frames are integers; `usdio`
converts once at the border. Nothing here reads, writes or computes.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize

MarkerSpace = Literal["captured", "stabilized"]


@dataclass(frozen=True)
class Markers:
    """A cloud of named markers over the frames of a take.

    Attributes
    ----------
    names : tuple of str
        One label per marker, unique.
    positions : (frames, markers, 3) float32 array
        [mm], Y up. A marker that is not seen keeps its last good position: never NaN.
    visible : (frames, markers) bool array
        False where the capture did not see the marker.
    confidence : (frames, markers) float32 array
        [0-1]; 1 as measured, lower where a sample was repaired.
    rigid : tuple of str
        Names of the markers that move with the skull alone.
    neutral_frame : int
        Frame number (not index) of the neutral face; the reference pose of the head.
    anchor : str
        Name of the marker nearest the head's origin; empty when there is none.
    space : {'captured', 'stabilized'}
        Whether head motion is still in.
    """

    names: tuple[str, ...]
    positions: Float32Array
    visible: BoolArray
    confidence: Float32Array
    rigid: tuple[str, ...] = ()
    neutral_frame: int = 0
    anchor: str = ""
    space: MarkerSpace = "captured"


@dataclass(frozen=True)
class WeightsClip:
    """Named float channels over time: a performance, or a take's own blendshape weights.

    Attributes
    ----------
    names : tuple of str
        Channel names, unique.
    values : (frames, channels) float32 array
        Usually in [0-1]; USD does not limit them.
    first_frame : int
        Frame number of ``values[0]``.
    rate : Fraction
        Frames per second.
    """

    names: tuple[str, ...]
    values: Float32Array
    first_frame: int
    rate: Fraction


Seconds = TypeVar("Seconds", float, FloatArray)


@dataclass(frozen=True)
class Video:
    """The camera's recording beside a take: take_time = offset + (1 + drift * 1e-6) * video_time.

    Attributes
    ----------
    file : Path
        The movie; referred to, never copied.
    rate : Fraction or None
        Frames per second as the file states it.
    offset, drift : float
        [s], [ppm]
    """

    file: Path
    rate: Fraction | None = None
    offset: float = 0.0
    drift: float = 0.0

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


@dataclass(frozen=True)
class Take:
    """One continuous recording of one performer.

    Attributes
    ----------
    name, performer, session, emotion : str
        Empty when unknown. Takes of one session share one application of markers.
    rate : Fraction
        Frames per second of the capture.
    first_frame : int
        Frame number of the first sample; a time code of the take is a frame number.
    source : WeightsClip or None
        Blendshape weights that the capture carries (Live Link, another solver).
    head_motion : (frames, 4, 4) float array or None
        Column-vector transforms that put stabilised markers back where they were captured.
    timecode_start : str
        SMPTE timecode of the first frame, empty when unknown.
    events : tuple of Event
        In the order of the recording.
    doubts : tuple of str or None
        What is odd about its markers, as ingest saw it; None where nobody has looked.
    """

    name: str
    rate: Fraction
    first_frame: int
    markers: Markers | None = None
    source: WeightsClip | None = None
    head_motion: FloatArray | None = None
    video: Video | None = None
    audio: Path | None = None
    performer: str = ""
    session: str = ""
    emotion: str = ""
    timecode_start: str = ""
    events: tuple[Event, ...] = ()
    doubts: tuple[str, ...] | None = None

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


@dataclass(frozen=True)
class ShapeKey:
    """One sculpted position of a shape: its full target, or an in-between.

    Attributes
    ----------
    weight : float
        Where on the channel this key is reached; 1 for the full target.
    points : (n,) int array
        The points it moves.
    offsets : (n, 3) float array
        [mm]
    normal_offsets : (n, 3) float array or None
    """

    weight: float
    points: IntArray
    offsets: FloatArray
    normal_offsets: FloatArray | None = None


@dataclass(frozen=True)
class MeshShape:
    """What one channel does to one mesh: keys in ascending weight, the full target at 1."""

    name: str
    keys: tuple[ShapeKey, ...]


@dataclass(frozen=True)
class RigMesh:
    """One mesh of a rig at rest, in the stage's world space.

    Attributes
    ----------
    path : str
        Prim path.
    points : (points, 3) float array
        [mm]
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    shapes : tuple of MeshShape
        The BlendShapes bound to this mesh, in the mesh's own order.
    colors : (points, 3) float array or None
        Linear display colour per point.
    normals : (points, 3) float array or None
        Authored point normals, if the mesh has them and they follow its points.
    subdivision : str
        ``'none'``, ``'catmullClark'``, ``'loop'`` or ``'bilinear'``.
    visible : bool
        False when hidden or not meant for rendering (purpose guide or proxy).
    face_colors : (polygons, 4) float array or None
        Linear colour and opacity that materials give polygons; NaN where none does.
    undrawn : tuple of str
        What of its materials pictures leave out.
    """

    path: str
    points: FloatArray
    face_counts: IntArray
    face_indices: IntArray
    shapes: tuple[MeshShape, ...] = ()
    colors: FloatArray | None = None
    normals: FloatArray | None = None
    subdivision: str = "none"
    visible: bool = True
    face_colors: FloatArray | None = None
    undrawn: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rig:
    """A character's face: meshes whose BlendShapes answer to named channels.

    Attributes
    ----------
    prim : str
        Path of the SkelRoot.
    shapes : tuple of str
        Channel names over all meshes, each once, in the order they are found.
    meshes : tuple of RigMesh
        Lengths in mm, Y up, whatever the stage's units are.
    ranges : (shapes, 2) float array
        Lowest and highest weight an animator may give; 0 to 1 unless the rig says otherwise.
    """

    file: Path
    prim: str
    shapes: tuple[str, ...]
    meshes: tuple[RigMesh, ...]
    ranges: FloatArray

    def check_has(self, shapes: Iterable[str], *, source: object, remedy: str) -> None:
        """Raise InputError where the rig lacks shapes.

        Parameters
        ----------
        shapes : iterable of str
            Names that must be there.
        source : object
            File whose shapes they are, as the message names it.
        remedy : str
            What the message advises.
        """
        names = list(shapes)
        missing = [name for name in names if name not in self.shapes]
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


@dataclass(frozen=True)
class MotionSpace:
    """What a performer's face does, in few numbers: principal components over whole takes.

    Attributes
    ----------
    mean : (markers * 3,) float array
        [mm]
    components : (dimensions, markers * 3) float array
        Orthonormal rows, the largest variance first.
    variances : (dimensions,) float array
        [mm^2]
    total_variance : float
        Of all dimensions, kept or not [mm^2].
    sample : (frames, dimensions) float array
        Coordinates of frames spread over the takes: the motion without labels.
    """

    mean: FloatArray
    components: FloatArray
    variances: FloatArray
    total_variance: float
    sample: FloatArray


@dataclass(frozen=True)
class References:
    """Frames of a take with the rig weights an animator wants there; pair *i* is at index *i*.

    Attributes
    ----------
    markers : (pairs, markers, 3) float array
        Stabilised positions [mm].
    weights : (pairs, shapes) float array
    frames : (pairs,) int array
        Frame number of each pair in its take.
    takes : tuple of str
        Name of each pair's take.
    tuned : (pairs,) bool array
        True where a person set the weights; False where they are still a proposal.
    rigid : tuple of str
        The markers that move with the skull alone.
    neutral : (markers, 3) float array
        The performer's neutral face in the space of `markers` [mm].
    motion : MotionSpace or None
        Of the takes the pairs were selected from; None for pairs made by hand.
    visemes, emotions : tuple of str
        Of each pair; empty where unknown, or where none is.
    performer, session : str
        Of the take whose head space and neutral face these are; empty where unknown.
    placement : Path or None
        Where the markers were placed on the rig.
    """

    marker_names: tuple[str, ...]
    shape_names: tuple[str, ...]
    markers: FloatArray
    weights: FloatArray
    frames: IntArray
    takes: tuple[str, ...]
    tuned: BoolArray
    rigid: tuple[str, ...]
    neutral: FloatArray
    rig_file: Path
    rig_prim: str
    motion: MotionSpace | None = None
    visemes: tuple[str, ...] = ()
    emotions: tuple[str, ...] = ()
    performer: str = ""
    session: str = ""
    placement: Path | None = None


@dataclass(frozen=True)
class CandidateScore:
    """How well one candidate predicted references it had not seen.

    Attributes
    ----------
    method, settings : str
        The candidate's hyper-parameters, readable.
    weight_rmse : float
        Root mean square error of the weights.
    vertex_rms_mm : float
        The same error as it shows on the rig's surface [mm]; NaN when no rig was given.
    """

    method: str
    settings: str
    weight_rmse: float
    vertex_rms_mm: float


@dataclass(frozen=True)
class TrainedMapping:
    """A trained function from stabilised markers to a rig's channels: all that predict needs.

    Attributes
    ----------
    method : str
        Name of the regression, a key of `usdface.model.regressions`.
    marker_names, shape_names : tuple of str
        Order of the input and of the output.
    rigid : tuple of str
        Markers by which another take is brought into this mapping's head space.
    neutral : (markers, 3) float array
        The performer's neutral face [mm]; defines that head space.
    ranges : (shapes, 2) float array
        Lowest and highest weight of each channel; predictions are limited to it.
    arrays : dict of str to float array
        What the method learned, by name.
    settings : dict of str to float, int, str or bool
        Hyper-parameters, given or chosen.
    scores : tuple of CandidateScore
        What cross-validation tried, best first.
    references : str
        The references it was trained on.
    """

    method: str
    marker_names: tuple[str, ...]
    shape_names: tuple[str, ...]
    rigid: tuple[str, ...]
    neutral: FloatArray
    ranges: FloatArray
    arrays: dict[str, FloatArray]
    settings: dict[str, float | int | str | bool] = field(default_factory=dict)
    scores: tuple[CandidateScore, ...] = ()
    references: str = ""


@dataclass(frozen=True)
class Performance:
    """The written result: weights over a rig, and how far they can be trusted.

    Attributes
    ----------
    uncertainty_mm : (frames, regions) float array or None
        Standard deviation of the surface around what an animator would key, of the face and its
        regions [mm]; of the face alone in layers of earlier versions.
    residual_mm : (frames, regions) float array or None
        Distance of the markers from anything the references' takes showed [mm].
    neutral_frame : int or None
        Frame of the take that shows the performer's neutral face; None where the weights were not
        mapped from markers.
    """

    weights: WeightsClip
    rig_file: Path
    rig_prim: str
    uncertainty_mm: FloatArray | None = None
    residual_mm: FloatArray | None = None
    regions: tuple[str, ...] = ()
    timecode_start: str = ""
    neutral_frame: int | None = None
