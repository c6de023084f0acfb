"""Read weights by frame from tables (CSV, JSON, NumPy) or USD of any tool."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.sniff import read_capture, recognise_format
from usdface.capture.weight_samples import read_weight_samples
from usdface.capture.weight_table import in_fractions, read_weight_take, row_frames
from usdface.core.arrays import BoolArray, FloatArray, IntArray, columns_by_name, index_of
from usdface.core.assets import WeightsClip
from usdface.core.errors import InputError
from usdface.core.sidecars import is_usd_name
from usdface.core.text import first_few, pluralize
from usdface.model.retarget.name_matching import Transfer, transfer_by_names
from usdface.usdio.performance.exported_weights import (
    ExportedWeights,
    blender_names,
    has_channels_per_mesh,
    is_of_blender,
    read_exported_weights,
)
from usdface.usdio.performance.read import PerformanceReader


@dataclass(frozen=True)
class WeightTable:
    """Weights of named shapes at frames."""

    names: tuple[str, ...]
    frames: tuple[int, ...]
    weights: FloatArray
    """(frames, shapes)"""
    rate: Fraction | None = None
    """Frames per second; None if the file does not state it, or its tool ignores it."""
    keyed: frozenset[int] = frozenset()
    """Frames with samples in the file; others, of USD, are interpolated."""
    between: int = 0
    """Samples of the file that lie between frames, and are left out."""
    meshes: tuple[str, ...] = ()
    """The mesh of each shape's weights, if the tool keys shapes per mesh; otherwise empty."""
    other_meshes: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    """By shape and mesh, the weights on the other meshes."""
    takes: tuple[str, ...] = ()
    """Take of each row; empty if the file does not state it."""
    clamped: bool = False
    """Whether the tool clamps weights to `CLAMP_RANGE`."""
    numbered: bool = True
    """Whether the file numbers its frames; otherwise they count from 1."""

    def columns(self, names: tuple[str, ...]) -> FloatArray:
        """Return the weights in another order of shapes; 0 for missing shapes."""
        return columns_by_name(self.weights, self.names, names)

    def at_frames(self, frames: IntArray, names: tuple[str, ...]) -> FloatArray:
        """Return the weights of shapes at frames, (frames, names); NaN at missing frames."""
        row_of = index_of(self.frames)
        rows = np.array([row_of.get(frame, -1) for frame in frames.tolist()], dtype=np.int64)
        return np.where(rows[:, None] < 0, np.nan, self.columns(names)[rows])

    def shapes_among(self, names: Sequence[str], *, file: Path, owner: str) -> list[str]:
        """Return the table's shapes that are among `names`; `owner` of these, for the message."""
        known = [name for name in self.names if name in names]
        if not known:
            raise InputError(
                f"{file}: none of its {pluralize(len(self.names), 'shape')} "
                f"({first_few(self.names, most=3)}) is {owner} ({first_few(names, most=3)}); "
                "rename its columns"
            )
        return known

    def renamed(self, transfer: Transfer) -> "WeightTable":
        """Return the table with the shapes that its shapes drive; unchanged if no name differs."""
        if all(name in transfer.target for name in self.names):
            return self
        columns = np.flatnonzero((transfer.matrix != 0).any(axis=0))
        rows = [self.names.index(name) for name in transfer.source]
        return replace(
            self,
            names=tuple(transfer.target[column] for column in columns.tolist()),
            weights=self.weights[:, rows] @ transfer.matrix[:, columns],
            meshes=(),
            other_meshes={},
        )

    def by_meaning(
        self, shapes: Sequence[str], *, leave: Collection[str] = ()
    ) -> tuple["WeightTable", Transfer]:
        """Return the table with names, except `leave`, matched by meaning, and the transfer."""
        names = tuple(name for name in self.names if name not in leave)
        transfer = transfer_by_names(names, shapes)
        table = self.renamed(transfer)
        return (table if table.names else self), transfer

    def notes(self, file: Path, known: Collection[str], *, owner: str) -> list[str]:
        """Return notes on frames without numbers, and on columns that are not among `known`.

        `owner` of the known shapes, for the message.
        """
        notes = []
        if not self.numbered:
            rate = "" if self.rate is None else f" at {float(self.rate):g} frames per second"
            notes.append(
                f"{file.name} has no column of frames: its {pluralize(len(self.frames), 'row')} "
                f"count from frame 1{rate}, as for `ingest`"
            )
        if self.between:
            notes.append(
                f"{pluralize(self.between, 'sample')} of {file.name} between frames left out: the "
                "weights at frames are read; bake the animation to whole frames there to keep its "
                "peaks"
            )
        unknown = [name for name in self.names if name not in known]
        if unknown:
            columns = pluralize(len(unknown), "column")
            notes.append(f"left out {columns} of {file.name}, not {owner}: {first_few(unknown)}")
        return notes

    def check_rate(self, rate: Fraction, *, file: Path, performance: Path) -> None:
        """Refuse a file with another rate than the performance's."""
        # 120 and 119.88 cannot be distinguished by rounded times, and number frames alike.
        if self.rate is not None and abs(self.rate / rate - 1) > Fraction(1, 500):
            raise InputError(
                f"{file}: runs at {float(self.rate):g} frames per second, {performance} at "
                f"{float(rate):g}; export it at the performance's rate, so that frames match"
            )

    def check_numbering(
        self, solved: WeightsClip, *, columns: Sequence[str], file: Path, performance: Path
    ) -> None:
        """Refuse rows whose weights match a performance far better if counted at another rate."""
        shared = [name for name in columns if name in self.names and name in solved.names]
        keys = columns_by_name(self.weights, self.names, shared)
        weights = columns_by_name(solved.values, solved.names, shared)

        def rows(ratio: float) -> IntArray:
            return np.rint((np.array(self.frames) - 1) * ratio).astype(int) + 1 - solved.first_frame

        def error(rows: IntArray, used: BoolArray) -> float:
            away = keys[used] - weights[rows[used]]
            return float(np.sqrt((away**2).mean())) if away.size else np.inf

        numbered = rows(1.0)
        present = (numbered >= 0) & (numbered < len(weights))
        for rate in USUAL_RATES:
            counted = rows(float(solved.rate) / rate)
            inside = (counted >= 0) & (counted < len(weights))
            # The same rows: those of another stretch may match better by being closer to neutral.
            both = inside & present
            if present.any() and not both.any():
                continue
            as_numbered = error(numbered, both)
            found = error(counted, both if both.any() else inside)
            if (
                inside.sum() >= _FEWEST_COUNTED
                and as_numbered > _LEAST_MISCOUNT
                and found < as_numbered / 2
            ):
                raise InputError(
                    f"{file}: its rows match {performance} if they count {rate:.5g} frames per "
                    f"second (a difference of {found:.2g} in the weights), not "
                    f"{float(solved.rate):.5g} ({as_numbered:.2g}); export it at the "
                    "performance's rate"
                )


def read_weight_table(
    path: Path,
    *,
    known: tuple[str, ...] = (),
    unit: str | None = None,
    shapes: Path | None = None,
    take: str | None = "",
) -> WeightTable:
    """Read weights by frame from a table (.csv, .json, .npy) or from USD.

    Parameters
    ----------
    known : tuple of str
        Expected shapes: names that a tool changed to identifiers are restored.
    unit : {'one', 'percent'}, optional
        Unit of a table. Default: detected, and refused if ambiguous.
    shapes : Path, optional
        Names of the columns of a .npy matrix; see `read_weight_samples`.
    take : str, optional
        Take whose rows are read of a table of several; empty if unknown: frames must then be
        unique. None: the rows of all takes.
    """
    if is_usd_name(path):
        if unit is not None or shapes is not None:
            option = "shapes" if unit is None else "weight-unit"
            raise InputError(
                f"{path}: --{option} is for tables of weights, this file states it; leave it out"
            )
        blender = is_of_blender(path)
        exported = read_exported_weights(path) if blender else _renamed_by_a_tool(path, known)
        if exported is not None:
            return _exported_table(exported, known, clamped=blender)
        reader = PerformanceReader(path)
        return _table_of_usd(reader, reader.names, reader.edited().astype(np.float64))
    return _table_of(path, unit, shapes, take)


def _recorded_table(path: Path) -> WeightTable | None:
    """Read a recorder's file by the frames of its take; None for plain tables."""
    try:
        found = recognise_format(path)
    except InputError:
        return None  # the table's reader raises the error
    take = None if found.read is read_weight_take else read_capture(path).take
    if take is None or take.source is None:
        return None
    frames = tuple(range(take.first_frame, take.first_frame + take.frame_count))
    values = take.source.values.astype(np.float64)
    return WeightTable(
        take.source.names, frames, values, take.rate, frozenset(frames), numbered=False
    )


def _table_of(path: Path, unit: str | None, shapes: Path | None, take: str | None) -> WeightTable:
    recorded = _recorded_table(path) if unit is None and shapes is None else None
    if recorded is not None:
        return recorded
    try:
        samples = read_weight_samples(path, shapes=shapes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    if take and len(set(samples.takes)) > 1:
        chosen = np.flatnonzero(np.array(samples.takes, object) == take)
        if not len(chosen):
            raise InputError(
                f"{path}: none of its takes ({first_few(dict.fromkeys(samples.takes), most=3)}) is "
                f"{take}; keep the rows of this take"
            )
        samples = samples.rows(chosen)
    numbers, rate = row_frames(path, samples)
    frames = tuple(numbers.tolist())
    takes = (take is None and samples.takes) or ("",) * len(frames)
    (named, twice), count = Counter(zip(takes, frames, strict=True)).most_common(1)[0]
    if count > 1:
        where = f" of take {named}" if named else ""
        raise InputError(f"{path}: frame {twice}{where} occurs {count} times; keep one row")
    values = in_fractions(path, samples.values, unit, samples.names, [])
    return WeightTable(
        samples.names,
        frames,
        values,
        rate,
        keyed=frozenset(frames),
        takes=samples.takes,
        numbered=samples.frames is not None,
    )


def _renamed_by_a_tool(path: Path, known: tuple[str, ...]) -> ExportedWeights | None:
    """Return weights by the shapes that channels of unknown names drive; None if not needed."""
    reader = PerformanceReader(path)
    if set(reader.names) & set(known):
        return None
    if has_channels_per_mesh(path):
        return read_exported_weights(path)
    if not known:
        return None
    exported = read_exported_weights(path)
    if exported is None:
        return None
    expected = {each for name in known for each in (name, *blender_names(name))}
    return exported if expected & set(exported.names) else None


def _exported_table(
    exported: ExportedWeights, known: tuple[str, ...], *, clamped: bool
) -> WeightTable:
    made = Counter(each for name in known for each in set(blender_names(name)))
    real = {each: name for name in known for each in blender_names(name) if made[each] == 1}
    names = tuple(real.get(name, name) for name in exported.names)
    weights = np.stack([curves[0].values for curves in exported.curves], axis=1)
    table = _table_of_usd(exported.reader, names, weights)
    return replace(
        table,
        rate=None if clamped else table.rate,  # Blender imports time codes as frames at any rate
        meshes=tuple(curves[0].mesh for curves in exported.curves),
        other_meshes={
            name: {curve.mesh: curve.values for curve in curves[1:]}
            for name, curves in zip(names, exported.curves, strict=True)
        },
        clamped=clamped,
    )


def _table_of_usd(
    reader: PerformanceReader, names: tuple[str, ...], weights: FloatArray
) -> WeightTable:
    return WeightTable(
        names,
        tuple(reader.frames.tolist()),
        weights,
        reader.rate,
        reader.keyed_frames,
        int(reader.between_frames.sum()),
    )


def missing_shape_notes(file: Path, names: Collection[str], wanted: Sequence[str]) -> list[str]:
    """Return a note on wanted shapes that are not among those of a file, and count as 0."""
    lacking = [name for name in wanted if name not in names]
    if not lacking:
        return []
    return [f"{file} lacks {pluralize(len(lacking), 'shape')}, taken as 0: {first_few(lacking)}"]


USUAL_RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 120.0, 24 / 1.001, 30 / 1.001, 60 / 1.001)
"""[frames/s]"""
_FEWEST_COUNTED = 20
"""Fewest rows from whose weights a rate is inferred."""
_LEAST_MISCOUNT = 0.03
"""Smallest root mean square difference of weights that another rate may explain."""
_LISTED_SHAPES = 5
CLAMP_RANGE = (0.0, 1.0)
"""Range of Blender's sliders, to which weights are clamped."""
CLAMP_TOLERANCE = 1e-5
"""Rounding of float32."""


def undo_clamping(table: WeightTable, name: str, rows: IntArray, current: FloatArray) -> FloatArray:
    """Return a shape's weights at some rows, undoing the clamping of a tool.

    `current`: (n,), weights now. Where they lie outside `CLAMP_RANGE` and the table has its end,
    the weight was clamped and not changed.
    """
    weights: FloatArray = table.weights[rows, table.names.index(name)]
    if not table.clamped:
        return weights
    end = np.clip(current, *CLAMP_RANGE)
    return np.where((end != current) & (np.abs(weights - end) < CLAMP_TOLERANCE), current, weights)


def changed_on_other_meshes(
    table: WeightTable,
    name: str,
    rows: IntArray,
    *,
    weights: FloatArray,
    current: FloatArray,
    solved: FloatArray,
    least: float,
) -> list[str]:
    """Return the meshes on which a shape was changed where the mesh that is read was not.

    Meshes whose weights equal the solve were not changed.
    """
    found = []
    unchanged = np.abs(weights - current) <= least
    for mesh, curve in table.other_meshes.get(name, {}).items():
        other = curve[rows]
        changed = (np.abs(other - current) > least) & (np.abs(other - solved) > least)
        if (unchanged & changed & ((other > CLAMP_RANGE[0]) & (other < CLAMP_RANGE[1]))).any():
            found.append(mesh)
    return found


def other_mesh_notes(table: WeightTable, found: Mapping[str, list[str]]) -> tuple[str, ...]:
    """Return notes on shapes that were changed on meshes that are not read."""
    notes = [
        f"{name} differs between {', '.join(meshes)} and {table.meshes[table.names.index(name)]}; "
        "the latter is read, as it has the most shapes; change it there"
        for name, meshes in list(found.items())[:_LISTED_SHAPES]
    ]
    rest = list(found)[_LISTED_SHAPES:]
    return (*notes, *([f"so do {first_few(rest)}"] if rest else []))
