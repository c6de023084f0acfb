"""Cleaned takes of one performer, brought into one order of markers and one head space."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust, remove_motion
from usdface.usdio.take.read import read_take

FEWEST_RIGID = 3
MIDDLE_FRAMES = 20_000
"""Enough for a median to a hundredth of the noise."""


@dataclass(frozen=True)
class CleanedTakes:
    """Frames of several takes as if of one.

    Attributes
    ----------
    marker_names : tuple of str
        Those that every take has.
    neutral : (markers, 3) float array
        Neutral face of the first take [mm].
    positions : tuple of (frames, markers, 3) float32 arrays
        One a take, in the first take's head space [mm].
    usable : tuple of (frames, markers) bool arrays
        Where a position was measured or repaired.
    frames : (frames,) int array
        Frame numbers, over all takes.
    takes : tuple of str
        Name of the take of each frame.
    dropped : tuple of str
        Markers that some take lacks.
    sources : tuple of Take
        What else each take says, without its samples.
    """

    marker_names: tuple[str, ...]
    rigid: tuple[str, ...]
    neutral: FloatArray
    positions: tuple[Float32Array, ...]
    usable: tuple[BoolArray, ...]
    frames: IntArray
    takes: tuple[str, ...]
    dropped: tuple[str, ...]
    sources: tuple[Take, ...]

    def places(self, rows: IntArray) -> list[tuple[int, int]]:
        """Return the take of each row of all frames, and its row in that take."""
        starts = np.cumsum([0, *(len(clip) for clip in self.positions)])
        take = np.searchsorted(starts, rows, side="right") - 1
        return list(zip(take.tolist(), (rows - starts[take]).tolist(), strict=True))

    def find_rows(self, frames: list[tuple[str, int]]) -> list[int | None]:
        """Return the row of each take and frame; None where there is none.

        A take's frames follow one another without a gap, so nothing is searched.
        """
        starts = np.cumsum([0, *(len(clip) for clip in self.positions)]).tolist()
        first = {
            source.name: (start, end, int(self.frames[start]))
            for source, start, end in zip(self.sources, starts, starts[1:], strict=False)
            if end > start
        }
        rows: list[int | None] = []
        for take, frame in frames:
            start, end, begins = first.get(take, (0, 0, 0))
            row = start + frame - begins
            rows.append(row if start <= row < end else None)
        return rows

    def positions_at(self, rows: IntArray) -> Float32Array:
        """Return the markers at rows of all frames, (rows, markers, 3) [mm]."""
        shape = (len(rows), len(self.marker_names), 3)
        found = [self.positions[take][row] for take, row in self.places(rows)]
        return np.array(found, dtype=np.float32).reshape(shape)

    def usable_at(self, rows: IntArray) -> BoolArray:
        """Return which markers were measured or repaired at rows of all frames."""
        return np.array([self.usable[take][row] for take, row in self.places(rows)], dtype=np.bool_)


def read_cleaned(path: Path) -> Take:
    """Read a take that has markers and no head motion.

    Raises
    ------
    InputError
        If it is another kind of take.
    """
    take = read_take(path, head_motion=False)
    if take.markers is None:
        raise InputError(f"{path}: has no markers; ingest a capture that has")
    if take.markers.space != "stabilized":
        raise InputError(f"{path}: still holds head motion; run `usdface clean {path}` first")
    return take


def read_cleaned_takes(paths: tuple[Path, ...]) -> CleanedTakes:
    """Read cleaned takes and bring them together.

    Raises
    ------
    InputError
        If a take is not cleaned, two have one name, or they share too few markers.
    """
    takes = [read_cleaned(path) for path in paths]
    _check_names(paths, takes)
    clouds = [take.markers for take in takes if take.markers is not None]
    shared = set.intersection(*(set(cloud.names) for cloud in clouds))
    names = tuple(name for name in clouds[0].names if name in shared)
    every = dict.fromkeys(name for cloud in clouds for name in cloud.names)
    rigid = tuple(name for name in names if all(name in cloud.rigid for cloud in clouds))
    if len(rigid) < FEWEST_RIGID:
        raise InputError(
            f"{', '.join(map(str, paths))}: {len(rigid)} rigid markers in common, at least "
            f"{FEWEST_RIGID} are needed; clean the takes with --rigid"
        )
    positions, usable = [], []
    for cloud in clouds:
        known = cloud.visible | (cloud.confidence > 0)
        if cloud.names == names:  # nothing to pick: an hour of markers is not copied
            positions.append(cloud.positions)
            usable.append(known)
        else:
            columns = [cloud.names.index(name) for name in names]
            positions.append(cloud.positions[:, columns])
            usable.append(known[:, columns])
    skull = [names.index(name) for name in rigid]
    home = _middle(positions[0], skull)
    for index in range(1, len(positions)):
        middle = _middle(positions[index], skull)[None]
        alignment = align_rigid_robust(middle, home, visible=np.ones((1, len(skull)), bool))
        flat = positions[index].reshape(1, -1, 3)
        moved = remove_motion(flat, alignment).reshape(positions[index].shape)
        positions[index] = moved.astype(np.float32)
    first = takes[0]
    row = clouds[0].neutral_frame - first.first_frame
    if not 0 <= row < first.frame_count:
        raise InputError(
            f"{paths[0]}: neutral frame {clouds[0].neutral_frame} is outside the take, "
            f"{first.first_frame}-{first.first_frame + first.frame_count - 1}; clean it with "
            "--neutral"
        )
    return CleanedTakes(
        marker_names=names,
        rigid=rigid,
        neutral=positions[0][row].astype(np.float64),
        positions=tuple(positions),
        usable=tuple(usable),
        frames=np.concatenate([take.frames for take in takes]),
        takes=tuple(take.name for take in takes for _ in range(take.frame_count)),
        dropped=tuple(name for name in every if name not in shared),
        sources=tuple(replace(take, markers=None, head_motion=None, source=None) for take in takes),
    )


def _middle(positions: Float32Array, columns: list[int]) -> FloatArray:
    """Return the median place of some markers, over frames spread through the take."""
    step = max(len(positions) // MIDDLE_FRAMES, 1)
    return np.asarray(np.median(positions[::step, columns].astype(np.float64), axis=0))


def _check_names(paths: tuple[Path, ...], takes: list[Take]) -> None:
    seen: dict[str, Path] = {}
    for path, take in zip(paths, takes, strict=True):
        if take.name in seen:
            raise InputError(
                f"{path} and {seen[take.name]} are both named {take.name!r}; pairs are told apart "
                "by take and frame: ingest one of them with --take NAME"
            )
        seen[take.name] = path
