"""Reading of takes of our schema, whole or by ranges of frames."""

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from usdface.core.arrays import Float32Array
from usdface.core.assets import Event, Markers, Take, Video, WeightsClip
from usdface.core.errors import InputError, as_input_error
from usdface.core.rates import (
    check_frame_span,
    exact_rate,
    frames_within,
    label_alike,
    shift_timecode,
)
from usdface.usdio.authoring import (
    file_of,
    names_in,
    read_array_samples,
    read_gaps,
    stated_spec,
    text_of,
    value_of,
)
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.take.write import AUDIO, HEAD_MOTION, MARKER_CONFIDENCE, MARKERS, SOURCE, VISIBLE
from usdface.usdio.units import column_matrix, stage_to_ours


@refusing_wrong_types
def is_take(path: Path) -> bool:
    """Whether a USD file is a take of our schema."""
    stage = open_stage(path)  # keep a reference: prims do not outlive their stage
    root = stage.GetDefaultPrim()
    return bool(root) and root.HasAPI("FaceTakeAPI")


MAX_SECONDS = 1e9
_LARGEST_DRIFT = 990_000.0
"""[ppm] At minus a million a video would stand still."""


class TakeReader:
    """A take on disk, whose frames are read on demand."""

    @refusing_wrong_types
    def __init__(self, path: Path) -> None:
        self.path = path
        self._stage = open_stage(path)
        root = self._stage.GetDefaultPrim()
        if not root or not root.HasAPI("FaceTakeAPI"):
            raise InputError(
                f"{path}: not a take: its default prim has no FaceTakeAPI; "
                "make one from it with `usdface ingest`"
            )
        self._root = root
        self.rate = exact_rate(
            self._stage.GetTimeCodesPerSecond(), where=f"{path}: timeCodesPerSecond"
        )
        start, end = self._stage.GetStartTimeCode(), self._stage.GetEndTimeCode()
        self._ours = stage_to_ours(self._stage)
        self._markers, self._head_motion, self._source, self._audio = (
            root.GetChild(place.name) for place in (MARKERS, HEAD_MOTION, SOURCE, AUDIO)
        )
        self._times: dict[str, np.ndarray] = {}
        check_frame_span(
            f"{path}: startTimeCode to endTimeCode", start, end, samples=self._samples()
        )
        self.first_frame, self.last_frame = round(start), round(end)

    def _samples(self) -> int | None:
        """Return the largest number of samples of what is read by frames; None without any."""
        counts = []
        if self._markers:
            counts.append(UsdGeom.Points(self._markers).GetPointsAttr().GetNumTimeSamples())
        if self._head_motion:
            operations = UsdGeom.Xformable(self._head_motion).GetOrderedXformOps()
            counts += [operation.GetNumTimeSamples() for operation in operations]
        if self._source:
            weights = UsdSkel.Animation(self._source).GetBlendShapeWeightsAttr()
            counts.append(weights.GetNumTimeSamples())
        return max(counts, default=None)

    @property
    def name(self) -> str:
        """The take's name, by default the file's."""
        return text_of(self._root, "face:take") or self.path.name.split(".")[0]

    @property
    def performer(self) -> str:
        """The performer's name; empty if unknown."""
        return text_of(self._root, "face:performer")

    @property
    def session(self) -> str:
        """The session in which the markers were applied; empty if unknown."""
        return text_of(self._root, "face:session")

    @functools.cached_property
    def neutral_frame(self) -> int:
        """Frame number of the neutral face, by default the first frame."""
        stated = stated_spec(self._markers, "face:markers:neutralFrame")
        return self.first_frame if stated is None else round(float(stated[1] * stated[0].default))

    @functools.cached_property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the markers; empty without markers."""
        prim = self._markers
        return names_in(prim.GetAttribute("face:markers:names")) if prim else ()

    def timecode_at(self, frame: int) -> str:
        """Return the SMPTE timecode of a frame; empty if unknown or if its labels do not fit."""
        stated = stated_spec(self._root, "face:timecode:start")
        if stated is None:
            return ""
        where, (spec, moved) = f"{self.path}: face:timecode:start", stated
        captured = exact_rate(self._stage.GetTimeCodesPerSecond() / abs(moved.scale), where=where)
        if not label_alike(captured, self.rate):
            return ""
        own = spec.layer
        start = moved * own.startTimeCode if own.HasStartTimeCode() else self.first_frame
        with as_input_error(where, of=InputError):
            return shift_timecode(str(spec.default), frame - round(start), self.rate)

    def frames_within(self, frames: tuple[int, int] | None) -> tuple[int, int]:
        """Return the first and the last of the frames, by default all; refuse missing ones."""
        return frames_within(self.path, frames, self.first_frame, self.last_frame)

    @refusing_wrong_types
    def read(
        self, first: int | None = None, last: int | None = None, *, head_motion: bool = True
    ) -> Take:
        """Read the frames `first` to `last`, inclusive; all by default.

        Without `head_motion` reading takes half the time.
        """
        first = self.first_frame if first is None else first
        last = self.last_frame if last is None else last
        self.frames_within((first, last))
        frames = range(first, last + 1)
        return Take(
            name=self.name,
            rate=self.rate,
            first_frame=first,
            markers=self.read_markers_at(frames),
            source=self.read_source(frames),
            head_motion=self._read_head_motion(frames) if head_motion else None,
            video=self.read_video(),
            audio=file_of(self._audio, "filePath") if self._audio else None,
            performer=self.performer,
            session=self.session,
            emotion=text_of(self._root, "face:emotion"),
            timecode_start=self.timecode_at(first),
            events=tuple(e for e in self._read_events() if first <= e.frame <= last),
            warnings=self.warnings,
        )

    @property
    def warnings(self) -> tuple[str, ...] | None:
        """Anomalies of its markers, by ingest; None if they were not examined."""
        written = value_of(self._root, "face:doubts")
        return tuple(map(str, written)) if isinstance(written, Iterable) else None

    @refusing_wrong_types
    def read_markers_at(self, frames: Sequence[int]) -> Markers | None:
        """Read the markers of some frames, in ascending order."""
        prim = self._markers
        if not prim:
            return None
        names = self.marker_names
        if not names:
            raise InputError(
                f"{self.path} <{prim.GetPath()}>: face:markers:names is empty; "
                "ingest the capture again"
            )
        read = read_array_samples(
            self.path,
            UsdGeom.Points(prim).GetPointsAttr(),
            frames,
            names,
            (3,),
            kind=np.float32,
            remedy="ingest the capture again; a marker that is not seen keeps its last position",
        )
        shape = read.shape[:2]
        visible = self._read_primvar(prim, VISIBLE, frames, shape, np.dtype(np.bool_))
        confidence = self._read_primvar(
            prim, MARKER_CONFIDENCE, frames, shape, np.dtype(np.float32)
        )
        space = text_of(prim, "face:markers:space")
        return Markers(
            names=names,
            positions=self._to_ours(read),
            visible=visible,
            confidence=confidence,
            rigid=names_in(prim.GetAttribute("face:markers:rigid")),
            neutral_frame=self.neutral_frame,
            anchor=text_of(prim, "face:markers:anchor"),
            space="stabilized" if space == "stabilized" else "captured",
        )

    def _to_ours(self, read: Float32Array) -> Float32Array:
        ours = self._ours.astype(np.float32)
        if np.array_equal(ours, ours[0, 0] * np.eye(3)):  # a Y-up stage
            read *= ours[0, 0]
            return read
        return np.asarray((read.reshape(-1, 3) @ ours.T).reshape(read.shape))

    def _read_primvar(
        self,
        prim: Usd.Prim,
        name: str,
        frames: Sequence[int],
        shape: tuple[int, int],
        kind: np.dtype,
    ) -> np.ndarray:
        attribute = prim.GetAttribute(name)
        if not attribute or not attribute.HasAuthoredValue():
            return np.broadcast_to(np.ones((), kind), shape)
        # Values are written where they change: read no frames between samples.
        if attribute.GetName() not in self._times:  # USD makes a list of all each time
            self._times[attribute.GetName()] = np.array(attribute.GetTimeSamples())
        times = self._times[attribute.GetName()]
        if not len(times):
            times = np.array([frames[0]])
        wanted = np.asarray(frames)
        before = np.searchsorted(times, wanted, "right") - 1
        around = np.concatenate([before, before + (times[before] != wanted)])
        times = times[np.unique(np.clip(around, 0, len(times) - 1))]
        values = np.empty((len(times), shape[1]), kind)
        query = Usd.AttributeQuery(attribute)
        for index, time in enumerate(times.tolist()):
            value = query.Get(time)
            if value is None or len(value) != shape[1]:
                raise InputError(
                    f"{self.path} <{attribute.GetPath()}> frame {time:g}: needs one value per "
                    f"marker, {shape[1]}; ingest the capture again"
                )
            values[index] = value
        if len(values) == 1:
            return np.broadcast_to(values[0], shape)
        return _between(times, values, wanted)

    @refusing_wrong_types
    def read_source(self, frames: range) -> WeightsClip | None:
        """Return the channels of the capture at some frames; None without any."""
        if not self._source:
            return None
        animation = UsdSkel.Animation(self._source)
        names = names_in(animation.GetBlendShapesAttr())
        weights = animation.GetBlendShapeWeightsAttr()
        remedy = "ingest the capture again"
        values = read_array_samples(
            self.path, weights, frames, names, kind=np.float32, remedy=remedy
        )
        return WeightsClip(names, values, frames[0], self.rate, read_gaps(self._source))

    @refusing_wrong_types
    def head_motion_from_neutral(self, first: int, last: int) -> np.ndarray | None:
        """Return the head motion relative to the neutral frame, in the head space there.

        (frames, 4, 4), for column vectors [mm]; None without head motion.
        """
        motion = self._read_head_motion(range(first, last + 1))
        at = min(max(self.neutral_frame, self.first_frame), self.last_frame)
        neutral = self._read_head_motion(range(at, at + 1))
        if motion is None or neutral is None:
            return None
        return np.asarray(np.linalg.inv(neutral[0]) @ motion)

    def _read_head_motion(self, frames: range) -> np.ndarray | None:
        if not self._head_motion:
            return None
        transform = UsdGeom.Xformable(self._head_motion)
        motion = np.array(
            [column_matrix(transform.GetLocalTransformation(frame)) for frame in frames]
        )
        turn = self._ours / np.linalg.norm(self._ours[0])
        motion[:, :3, :3] = turn @ motion[:, :3, :3] @ turn.T
        motion[:, :3, 3] = motion[:, :3, 3] @ self._ours.T
        return motion

    def _read_events(self) -> list[Event]:
        labels = self._root.GetAttribute("face:events:labels").Get() or ()
        times = self._root.GetAttribute("face:events:times").Get() or ()
        if len(labels) != len(times):
            raise InputError(
                f"{self.path}: {len(labels)} face:events:labels for {len(times)} face:events:times;"
                " author one of each per event"
            )
        return [Event(str(label), float(time)) for label, time in zip(labels, times, strict=True)]

    @refusing_wrong_types
    def read_video(self) -> Video | None:
        """Return the take's video, which may be missing; None if it names none."""
        file = file_of(self._root, "face:video:file")
        if file is None:
            return None
        rate = value_of(self._root, "face:video:rate")
        where = f"{self.path}: face:video:rate"
        offset, drift = (
            float(str(value_of(self._root, f"face:video:{name}") or 0))
            for name in ("offset", "drift")
        )
        if not (abs(offset) < MAX_SECONDS and abs(drift) < _LARGEST_DRIFT):  # also catches NaN
            raise InputError(
                f"{self.path}: face:video:offset {offset:g} s and face:video:drift {drift:g} ppm "
                "are no place in time; align the video again"
            )
        return Video(
            file=file,
            rate=exact_rate(rate, where=where) if isinstance(rate, float) and rate > 0 else None,
            offset=offset,
            drift=drift,
        )


def _between(times: np.ndarray, values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return values at frames as USD does: floats interpolated linearly, others held."""
    if np.array_equal(times, frames):
        return values
    before = np.clip(np.searchsorted(times, frames, "right") - 1, 0, len(times) - 1)
    out = values[before]
    if np.issubdtype(values.dtype, np.floating):
        after = np.minimum(before + 1, len(times) - 1)
        step = np.where(after > before, times[after] - times[before], 1)
        share = np.clip((frames - times[before]) / step, 0, 1)
        changes = np.append((values[1:] != values[:-1]).any(axis=1), False)
        moving = np.flatnonzero((share > 0) & changes[before])
        change = values[after[moving]] - values[before[moving]]
        out[moving] += (share[moving, None] * change).astype(values.dtype)
    return out


def read_take(
    path: Path, *, first: int | None = None, last: int | None = None, head_motion: bool = True
) -> Take:
    """Read a take, or a range of its frames; see `TakeReader.read`."""
    return TakeReader(path).read(first, last, head_motion=head_motion)


def read_first_frame(path: Path) -> Take:
    """Read a take with its first frame only: for its name, rate, video and sound."""
    reader = TakeReader(path)
    return reader.read(reader.first_frame, reader.first_frame, head_motion=False)
