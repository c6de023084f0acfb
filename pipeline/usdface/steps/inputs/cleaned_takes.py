"""Read cleaned takes of one performer in a common marker order and head space."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, sample_frames
from usdface.core.assets import Markers, References, Rig, Take
from usdface.core.errors import InputError, as_input_error
from usdface.core.text import shell_word
from usdface.core.trajectories import TRAJECTORY_SECONDS, read_trajectories
from usdface.model.mapping.head_space import MINIMUM_SHARE, HeadSpace, find_head_space
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.mapping.take_neutral import TakeNeutral
from usdface.model.placement.plausibility import check_findings, judge_markers
from usdface.model.placement.rig_orientation import check_rig_upright, covered_face_notes
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.numerics.rigid.rigid_alignment import FEWEST_RIGID
from usdface.numerics.rigid.rigid_template import RigidTemplate
from usdface.usdio.take.read import TakeReader, read_take


def take_head_space(take: TakeReader, face: PerformerFace) -> HeadSpace:
    """Find the transform from a take's markers to those of a face, from frames all over it."""
    span = take.first_frame, take.last_frame
    known = _known_frames(face, take.name, take.neutral_frame, span)
    picks = np.union1d(spread_frames(take, SAMPLE_FRAMES), known)
    sample = read_markers_at(take, picks.tolist())
    with as_input_error(take.path, of=InputError):
        return _head_space(face, sample, picks, take)


def _known_frames(
    face: PerformerFace, take: str, neutral_frame: int, span: tuple[int, int]
) -> IntArray:
    """Return the frames of a take's reference pairs and its neutral one, within a range."""
    pairs = [frames for name, (frames, _) in face.pairs.items() if name == take]
    known = np.concatenate([*pairs, [neutral_frame]])
    return known[(span[0] <= known) & (known <= span[1])]


def _head_space(
    face: PerformerFace, sample: Markers, frames: IntArray, take: Take | TakeReader
) -> HeadSpace:
    return find_head_space(
        face,
        sample,
        frames=frames,
        rate=float(take.rate),
        take=take.name,
        performer=take.performer,
        session=take.session,
    )


def spread_frames(take: TakeReader, most: int, frames: tuple[int, int] | None = None) -> list[int]:
    """Return at most `most` frames, spread evenly over a take, or over some frames of it."""
    first, last = frames or (take.first_frame, take.last_frame)
    picks = np.linspace(first, last, min(last - first + 1, most))
    return list(map(int, np.unique(picks.astype(int))))


def read_markers_at(take: TakeReader, frames: Sequence[int]) -> Markers:
    """Read the markers of some frames, in ascending order; refuse a take that has none."""
    markers = take.read_markers_at(frames)
    if markers is None:
        raise InputError(f"{take.path}: has no markers; ingest a capture that has")
    return markers


_HEAD_SPACE_FRAMES = 2000
"""Frames used to find the head space of several takes, evenly spread."""
_LEAST_SEEN = 0.5
"""[of the frames] In which a marker must be usable: pairs have its prediction in the others."""
_COMPARED_FRAMES = 20_000
"""Frames of a take that are compared with those before it; their median has 1 % of the noise."""


@dataclass(frozen=True)
class CleanedTakes:
    """Several takes with common markers, concatenated."""

    marker_names: tuple[str, ...]
    """The markers that every take has, seen in half of the frames or more."""
    rigid: tuple[str, ...]
    neutral: FloatArray
    """(markers, 3): neutral face of the first take [mm]."""
    positions: tuple[Float32Array, ...]
    """Per take, (frames, markers, 3): in the head space and with the neutral face of the first
    take [mm]."""
    usable: tuple[BoolArray, ...]
    """Per take, (frames, markers): whether a position was measured or repaired."""
    frames: IntArray
    """(frames,): frame numbers, over all takes."""
    takes: tuple[str, ...]
    """Name of the take of each frame."""
    dropped: tuple[str, ...]
    """Markers that some take lacks, or that are seen in less than half of the frames."""
    sources: tuple[Take, ...]
    """The takes without their samples."""
    neutrals: tuple[TakeNeutral, ...]
    """Difference of each take's neutral face from the first one's, removed from `positions`."""

    @property
    def starts(self) -> IntArray:
        """Row of the first frame of each take, and the number of all frames."""
        return np.cumsum([0, *(len(clip) for clip in self.positions)])

    def take_rows(self, rows: IntArray) -> list[tuple[int, int]]:
        """Return the take of each row of all frames, and its row in that take."""
        starts = self.starts
        take = np.searchsorted(starts, rows, side="right") - 1
        return list(zip(take.tolist(), (rows - starts[take]).tolist(), strict=True))

    def find_rows(self, frames: list[tuple[str, int]]) -> list[int | None]:
        """Return the row of each take and frame; None if there is none."""
        every = zip(self.takes, self.frames.tolist(), strict=True)
        row_of = {each: row for row, each in enumerate(every)}
        return [row_of.get(each) for each in frames]

    def positions_at(self, rows: IntArray) -> Float32Array:
        """Return the markers at rows of all frames, (rows, markers, 3) [mm]."""
        shape = (len(rows), len(self.marker_names), 3)
        found = [self.positions[take][row] for take, row in self.take_rows(rows)]
        return np.array(found, dtype=np.float32).reshape(shape)

    def usable_at(self, rows: IntArray) -> BoolArray:
        """Return which markers were measured or repaired at rows of all frames."""
        return np.array(
            [self.usable[take][row] for take, row in self.take_rows(rows)], dtype=np.bool_
        )

    def markers_at(self, rows: IntArray) -> Markers:
        """Return the markers at rows of all frames, with their names and visibility."""
        visible = self.usable_at(rows)
        return Markers(
            names=self.marker_names,
            positions=self.positions_at(rows),
            visible=visible,
            confidence=visible.astype(np.float32),
            rigid=self.rigid,
            neutral_frame=self.neutrals[0].stated_frame,
            space="stabilized",
        )

    def head_space(self, face: PerformerFace) -> HeadSpace:
        """Find the transform from the common head space of the takes to that of a face."""
        # Frames are numbered as in the first take, and on from there.
        take, first = self.sources[0], int(self.frames[0])
        span = first, first + len(self.positions[0]) - 1
        known = _known_frames(face, take.name, self.neutrals[0].stated_frame, span)
        rows = np.union1d(sample_frames(len(self.frames), _HEAD_SPACE_FRAMES), known - first)
        return _head_space(face, self.markers_at(rows), rows + first, take)

    def aligned_by(self, rigid: tuple[str, ...]) -> "CleanedTakes":
        """Return the takes with the head motion of their frames removed by other markers."""
        columns = np.array([self.marker_names.index(name) for name in rigid], np.int64)
        template = RigidTemplate(columns, self.neutral[columns])
        clips = zip(self.positions, self.usable, strict=True)
        positions = tuple(template.align(clip, seen) for clip, seen in clips)
        return replace(self, rigid=rigid, positions=positions)

    def new_references(self, rig: Rig, rows: IntArray, weights: FloatArray) -> References:
        """Return pairs at rows of all frames, with weights to be tuned, (rows, shapes)."""
        first = self.sources[0]
        markers = self.positions_at(rows).astype(np.float64)
        return References(
            marker_names=self.marker_names,
            shape_names=rig.shapes,
            markers=markers,
            trajectories=self._trajectories(rows) - markers[:, None] if self.marker_names else None,
            weights=weights,
            frames=self.frames[rows],
            takes=tuple(self.takes[row] for row in rows),
            tuned=np.zeros(len(rows), dtype=np.bool_),
            rigid=self.rigid,
            neutral=self.neutral,
            rig_file=rig.file,
            rig_prim=rig.prim,
            combinations=rig.combinations,
            performer=first.performer,
            session=first.session,
            neutral_take=first.name,
            rate=float(first.rate),
        )

    def _trajectories(self, rows: IntArray) -> FloatArray:
        """Return the markers about rows of all frames: (rows, times, markers, 3) [mm]."""
        found = np.empty((len(rows), len(TRAJECTORY_SECONDS), len(self.marker_names), 3))
        of_take = np.array(self.take_rows(rows), np.int64).reshape(-1, 2)
        for take in np.unique(of_take[:, 0]):
            here, clip = of_take[:, 0] == take, self.positions[take]
            found[here] = read_trajectories(
                of_take[here, 1],
                rate=float(self.sources[take].rate),
                first=0,
                last=len(clip) - 1,
                positions_at=clip.__getitem__,
            )
        return found


def read_cleaned(path: Path, *, need_markers: bool = True) -> Take:
    """Read a take without head motion that has markers or, if they are not needed, weights."""
    take = read_take(path, head_motion=False)
    if take.markers is None:
        if not need_markers and take.source is not None:
            return take
        raise InputError(f"{path}: has no markers; ingest a capture that has")
    check_stabilized(path, take.markers)
    return take


def check_stabilized(path: Path, markers: Markers) -> None:
    """Refuse markers that still hold the head's motion."""
    if markers.space != "stabilized":
        raise InputError(
            f"{path}: still holds head motion; run `usdface clean {shell_word(path)}` first"
        )


def check_neutral_frame(
    path: Path, frame: int, take: Take | TakeReader, remedy: str = "clean it with --neutral"
) -> None:
    """Refuse a neutral frame that is not one of a take's."""
    if not take.first_frame <= frame <= take.last_frame:
        raise InputError(
            f"{path}: neutral frame {frame} is outside the take, {take.first_frame}-"
            f"{take.last_frame}; {remedy}"
        )


def read_cleaned_takes(paths: tuple[Path, ...]) -> CleanedTakes:
    """Read cleaned takes in a common marker order, head space and neutral face."""
    takes = [read_cleaned(path) for path in paths]
    check_take_names(paths, takes)
    _check_performers(paths, takes)
    clouds = [take.markers for take in takes if take.markers is not None]
    common = set.intersection(*(set(cloud.names) for cloud in clouds))
    seen = Counter[str]()
    for cloud in clouds:
        seen.update(dict(zip(cloud.names, cloud.usable.sum(axis=0).tolist(), strict=True)))
    least = _LEAST_SEEN * sum(len(cloud.positions) for cloud in clouds)
    shared = {name for name in common if seen[name] >= least}
    names = tuple(name for name in clouds[0].names if name in shared)
    every = dict.fromkeys(name for cloud in clouds for name in cloud.names)
    rigid = tuple(name for name in names if name in clouds[0].rigid)
    _check_marker_sets(paths, clouds, names, rigid)
    positions, usable = [], []
    for cloud in clouds:
        columns: slice | list[int] = slice(None)  # long takes are not copied if need not be
        if cloud.names != names:
            columns = [cloud.names.index(name) for name in names]
        positions.append(cloud.positions[:, columns])
        usable.append(cloud.usable[:, columns])
    frame = clouds[0].neutral_frame
    check_neutral_frame(paths[0], frame, takes[0])
    neutral = positions[0][frame - takes[0].first_frame].astype(np.float64)
    neutrals = _onto_first(paths, takes, (names, rigid), neutral, frame, positions, usable)
    return CleanedTakes(
        marker_names=names,
        rigid=rigid,
        neutral=neutral,
        positions=tuple(positions),
        usable=tuple(usable),
        frames=np.concatenate([take.frames for take in takes]),
        takes=tuple(take.name for take in takes for _ in range(take.frame_count)),
        dropped=tuple(name for name in every if name not in shared),
        sources=tuple(replace(take, markers=None, head_motion=None, source=None) for take in takes),
        neutrals=neutrals,
    )


def _onto_first(
    paths: tuple[Path, ...],
    takes: list[Take],
    names: tuple[tuple[str, ...], tuple[str, ...]],
    neutral: FloatArray,
    neutral_frame: int,
    positions: list[Float32Array],
    usable: list[BoolArray],
) -> tuple[TakeNeutral, ...]:
    """Replace positions by those in the head space and with the neutral face of the first take.

    Each take is compared with all before it, since two takes may share no expression.
    """
    marker_names, rigid = names
    neutrals = [
        TakeNeutral(marker_names, np.zeros_like(neutral), 0.0, neutral_frame, neutral_frame)
    ]
    for index in range(1, len(takes)):
        share = -(-SAMPLE_FRAMES // index)  # of each take
        before = [(take, sample_frames(takes[take].frame_count, share)) for take in range(index)]
        frames = np.concatenate([positions[take][row].astype(np.float64) for take, row in before])
        seen = np.concatenate([usable[take][row] for take, row in before])
        face = PerformerFace(
            marker_names, rigid, neutral, frames, seen, takes[0].performer, takes[0].session
        )
        take, cloud = takes[index], takes[index].markers
        row = 0 if cloud is None else cloud.neutral_frame - take.first_frame
        rows = sample_frames(take.frame_count, _COMPARED_FRAMES)
        if 0 <= row < take.frame_count:
            rows = np.union1d(rows, row)
        sample = Markers(
            names=marker_names,
            positions=positions[index][rows],
            visible=usable[index][rows],
            confidence=usable[index][rows].astype(np.float32),
            rigid=() if cloud is None else cloud.rigid,
            neutral_frame=row + take.first_frame,
            space="stabilized",
        )
        with as_input_error(f"{paths[index]}, with {paths[0]}", of=InputError):
            space = _head_space(face, sample, take.frames[rows], take)
        positions[index] = space.move(positions[index], usable[index])
        neutrals.append(space.neutral)
    return tuple(neutrals)


def _check_marker_sets(
    paths: tuple[Path, ...], clouds: list[Markers], names: tuple[str, ...], rigid: tuple[str, ...]
) -> None:
    """Refuse takes of different marker sets, such as markers and landmarks of a video."""
    least = min(len(cloud.names) for cloud in clouds)
    if len(names) < MINIMUM_SHARE * least:
        counts = ", ".join(str(len(cloud.names)) for cloud in clouds)
        raise InputError(
            f"{', '.join(map(str, paths))}: takes of several marker sets, of {counts} markers with "
            f"{len(names)} labels in common; a mapping reads one marker set: select from the takes "
            "of each set separately"
        )
    if len(rigid) < FEWEST_RIGID:
        raise InputError(
            f"{', '.join(map(str, paths))}: {len(rigid)} common rigid markers, at least "
            f"{FEWEST_RIGID} are needed; clean the takes with --rigid"
        )


def check_take_names(paths: tuple[Path, ...], takes: Sequence[Take]) -> None:
    """Refuse takes of which two have one name."""
    seen: dict[str, Path] = {}
    for path, take in zip(paths, takes, strict=True):
        if take.name in seen:
            raise InputError(
                f"{path} and {seen[take.name]} are both named {take.name!r}; pairs are identified "
                "by take and frame: ingest one of them with --take NAME"
            )
        seen[take.name] = path


def _check_performers(paths: tuple[Path, ...], takes: list[Take]) -> None:
    """Refuse takes that state several performers."""
    stated = {take.performer: path for path, take in zip(paths, takes, strict=True)}
    stated.pop("", None)
    if len(stated) > 1:
        shown = ", ".join(f"{path}: {performer}" for performer, path in stated.items())
        raise InputError(
            f"takes of {len(stated)} performers ({shown}); a mapping is of one performer: select "
            "from each performer's takes separately, or correct the name with `usdface ingest "
            "--performer`"
        )


_WARNING_FRAMES = 64


def plausibility_notes(takes: CleanedTakes, paths: tuple[Path, ...], rig: Rig) -> list[str]:
    """Return warnings about takes and the rig; refuse takes that cannot be of a human face."""
    of_rig = (*check_rig_upright(rig), *covered_face_notes(rig))
    notes = [f"{rig.file.name}: {warning}" for warning in of_rig]
    for index, (path, source) in enumerate(zip(paths, takes.sources, strict=True)):
        warnings = source.warnings
        if warnings is None:
            usable = takes.usable[index]
            markers = Markers(
                takes.marker_names, takes.positions[index], usable, usable.astype(np.float32)
            )
            warnings = _judge(markers, path, float(source.rate))
        notes += [f"{source.name}: {warning}" for warning in warnings]
    return notes


def take_warnings(take: TakeReader) -> list[str]:
    """Return warnings about a take: those of ingest, else by frames spread over it."""
    if take.warnings is not None:
        return list(take.warnings)
    markers = take.read_markers_at(spread_frames(take, _WARNING_FRAMES))
    return [] if markers is None else list(_judge(markers, take.path, None))


def _judge(markers: Markers, path: Path, rate: float | None) -> tuple[str, ...]:
    return check_findings(
        judge_markers(markers, rate), where=path, before_remedy="ingest it again and "
    )
