"""Tables of weights from any tool: CSV, JSON or NumPy arrays.

CSV: one row per frame, a column per shape, and a column of frames or times (``Frame``, ``time_s``,
``timestamp_ms``), between commas, semicolons or tabs. JSON: rows of the same; lists of MediaPipe's
``{categoryName, score}``; or names and a matrix, as written by Audio2Face (``facsNames``,
``weightMat``) and others. ``.npy``: a matrix, with the names in a second file.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from usdface.capture.sample_times import index_kind, index_seconds
from usdface.capture.text_table import (
    head_lines,
    read_header,
    read_lines,
    read_number_table,
    sniff_delimiter,
)
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.rates import MAX_FRAME, exact_rate
from usdface.core.text import first_few, read_json, read_text, repeated

LARGEST_JSON_BYTES = 1 << 30
_LARGEST_NAMES_BYTES = 16 << 20
_COUNTED = ("frame", "time", "s", "ms")
_TEXTS = ("take", "timecode")
_NAME_KEYS = (
    "facsNames",
    "names",
    "blendShapeNames",
    "blendshapeNames",
    "blendshape_names",
    "shapes",
)
_MATRIX_KEYS = ("weightMat", "weights", "frames", "data")
_RATE_KEYS = ("exportFps", "fps", "frameRate", "frame_rate", "rate")
_ROW_KEYS = (
    "blendshapes",
    "blendShapes",
    "face_blendshapes",
    "faceBlendshapes",
    "weights",
    "scores",
    "values",
)
_JSON_KEYS = re.compile(
    r'"(facsNames|weightMat|categoryName|category_name|(face_?)?blendshapes|weights|frame)"\s*:'
    r'|"((face_?)?blendshape_?)?names"\s*:\s*\[\s*"',
    re.IGNORECASE,
)
_FEWEST_SHAPES = 2
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class WeightSamples:
    """Weights as stored in a file."""

    names: tuple[str, ...]
    values: FloatArray
    """(rows, shapes)"""
    lines: IntArray
    """(rows,): line or row number in the file, for messages."""
    frames: FloatArray | None = None
    """(rows,): frame numbers, if the file has them."""
    seconds: FloatArray | None = None
    """(rows,) [s]"""
    takes: tuple[str, ...] = ()
    """Name of each row's take; empty if the file has no such column."""
    rate: Fraction | None = None
    """Frames per second stated by the file."""
    ignored: tuple[str, ...] = ()
    """Names of the rows' other values, such as landmarks."""

    def rows(self, chosen: IntArray) -> "WeightSamples":
        """Return a copy with some of the rows."""
        return replace(
            self,
            values=self.values[chosen],
            lines=self.lines[chosen],
            frames=None if self.frames is None else self.frames[chosen],
            seconds=None if self.seconds is None else self.seconds[chosen],
            takes=tuple(self.takes[index] for index in chosen.tolist()) if self.takes else (),
        )


def is_weight_csv(head: bytes) -> bool:
    """Return whether a file is a table of numbers below names, from its first bytes.

    The least specific format: try it last.
    """
    lines = [line for line in head_lines(head, 3) if line.strip()]
    if len(lines) < 2:
        return False
    delimiter = sniff_delimiter(lines[0])
    if delimiter is None:
        return False
    titles = [cell.strip('" ') for cell in lines[0].split(delimiter)]
    cells = [cell.strip('" ') for cell in lines[1].split(delimiter)]
    kinds = [index_kind(title) for title in titles]
    shapes = [title for title, kind in zip(titles, kinds, strict=True) if title and not kind]
    if len(shapes) < _FEWEST_SHAPES or any(map(_NUMBER.fullmatch, shapes)):
        return False
    numbers = [bool(_NUMBER.fullmatch(cell)) for cell in cells if cell]
    return any(kinds) or (bool(numbers) and all(numbers))


def is_weight_json(head: bytes) -> bool:
    """Return whether a file is JSON of weights, from its first character and its keys."""
    text = "\n".join(head_lines(head, 1000)).lstrip()
    return text[:1] in ("[", "{") and _JSON_KEYS.search(text) is not None


def is_weight_npy(head: bytes) -> bool:
    """Return whether a file is a NumPy array, from its first bytes."""
    return head.startswith(b"\x93NUMPY")


def read_weight_samples(path: Path, *, shapes: Path | None = None) -> WeightSamples:
    """Read a table of weights in the file's units.

    `shapes`: file with the names of a matrix's columns: one per line, or a JSON list, or ``.npy``.
    Default: ``NAME.names.txt``, ``.json`` or ``.npy`` in the same folder.
    """
    check_may_open(path)
    with path.open("rb") as file:
        head = file.read(64)
    start = "".join(head_lines(head, 4)).lstrip()[:1]
    if is_weight_npy(head) or path.suffix.lower() == ".npy":
        samples = _read_npy(path, shapes)
    else:
        samples = _read_json(path) if start in ("[", "{") else _read_csv(path)
    if not len(samples.values):
        raise InputError(f"{path}: holds no rows of weights")
    return samples


def _read_csv(path: Path) -> WeightSamples:
    lines = read_lines(path)
    header, delimiter, titles = read_header(lines)
    kinds = [index_kind(title) for title in titles]
    if not any(kind in _COUNTED for kind in kinds) and len(titles) < _FEWEST_SHAPES:
        raise InputError(
            f"{header.where}: has no `frame` column; the first line must name the columns"
        )
    if twice := repeated(filter(None, kinds)):
        raise InputError(f"{header.where}: {twice[0]} is in two columns; keep one")
    texts = [at for at, kind in enumerate(kinds) if kind in _TEXTS]
    table = read_number_table(
        lines, titles, path=path, delimiter=delimiter, gaps=False, texts=texts
    )
    at = {kind: place for place, kind in enumerate(kinds) if kind}
    columns = [place for place, kind in enumerate(kinds) if not kind]
    return WeightSamples(
        tuple(titles[place] for place in columns),
        table.values[:, columns],
        table.lines,
        table.values[:, at["frame"]] if "frame" in at else None,
        index_seconds(at, table.values),
        tuple(table.texts[at["take"]]) if "take" in at else (),
    )


def _read_json(path: Path) -> WeightSamples:
    data = read_json(path, LARGEST_JSON_BYTES)
    rate = None
    if isinstance(data, dict):
        stated = next((data[key] for key in _RATE_KEYS if key in data), None)
        if stated is not None:
            rate = exact_rate(read_cell(path, "its rate", "fps", stated), where=str(path))
        names = next((data[key] for key in _NAME_KEYS if isinstance(data.get(key), list)), None)
        matrix = next((data[key] for key in _MATRIX_KEYS if isinstance(data.get(key), list)), None)
        if names is None:
            data = matrix
        else:
            data = None if matrix is None else _named_rows(path, names, matrix)
    if not isinstance(data, list) or not all(isinstance(row, dict | list) for row in data):
        raise InputError(
            f'{path}: must be a list of rows like {{"frame": 12, "jawOpen": 0.4}}, or names and a '
            "matrix of weights, as Audio2Face writes (facsNames, weightMat)"
        )
    return replace(_json_rows(path, data), rate=rate)


def _named_rows(path: Path, names: list[Any], matrix: list[Any]) -> list[dict[str, Any]]:
    """Return rows of weights by name, with each row's frame or time."""
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{path}: its list of names holds more than names; export it again")
    _check_unique(path, names)
    rows = []
    for index, row in enumerate(matrix):
        index_cells = {}
        weights = row
        if isinstance(row, dict):
            index_cells = {name: value for name, value in row.items() if index_kind(name)}
            weights = next((row[key] for key in _ROW_KEYS if key in row), None)
        if not isinstance(weights, list) or len(weights) != len(names):
            count = len(weights) if isinstance(weights, list) else 0
            raise InputError(
                f"{path} row {index + 1}: {count} weights for {len(names)} names; export it again"
            )
        rows.append(index_cells | dict(zip(names, weights, strict=True)))
    return rows


def _json_rows(path: Path, data: list[Any]) -> WeightSamples:
    rows = [_flat(path, index, row) for index, row in enumerate(data)]
    keys = list(dict.fromkeys(name for row in rows for name in row))
    at = {index_kind(name): name for name in keys if index_kind(name)}
    spare = [name for name in keys if at.get(index_kind(name), name) != name]
    if spare:
        raise InputError(
            f"{path}: {spare[0]} and {at[index_kind(spare[0])]} both say "
            f"{index_kind(spare[0])}; keep one"
        )
    names = [name for name in keys if not index_kind(name)]
    values = np.zeros((len(rows), len(names)))
    for index, row in enumerate(rows):
        for column, name in enumerate(names):
            values[index, column] = read_cell(path, f"row {index + 1}", name, row.get(name, 0.0))

    def series(kind: str) -> FloatArray | None:
        if kind not in at:
            return None
        name = at[kind]
        given = [read_cell(path, f"row {i + 1}", name, r.get(name)) for i, r in enumerate(rows)]
        return np.array(given)

    counted = {kind: found for kind in _COUNTED if (found := series(kind)) is not None}
    frames, places = counted.get("frame"), {kind: place for place, kind in enumerate(counted)}
    seconds = index_seconds(places, np.stack([*counted.values()], axis=1)) if counted else None
    takes = tuple(str(row.get(at["take"], "")) for row in rows) if "take" in at else ()
    lines = np.arange(1, len(rows) + 1)
    faces = np.flatnonzero([any(not index_kind(name) for name in row) for row in rows])
    if 0 < len(faces) < len(rows) and frames is None and seconds is None:
        frames = lines.astype(np.float64)
    ignored = dict.fromkeys(name for row in data for name in _ignored(row))
    samples = WeightSamples(
        tuple(names), values, lines, frames, seconds, takes, ignored=tuple(ignored)
    )
    return samples.rows(faces)  # a row without a face is a gap, not a face at rest


def _flat(path: Path, index: int, row: Any) -> dict[str, Any]:
    """Return a row as values by name: nested weights and lists of categories are flattened."""
    if isinstance(row, list):
        return _categories(path, index, row)
    key = _weights_key(row)
    if key is None:
        return dict(row)
    inner = row[key]
    faces = inner if isinstance(inner, list) else []
    lists = [each.get("categories") if isinstance(each, dict) else each for each in faces]
    if lists and all(isinstance(each, list) for each in lists):  # MediaPipe's faces of a picture
        if len(lists) > 1:
            raise InputError(
                f"{path} row {index + 1}: holds {len(lists)} faces; export the scores of one"
            )
        inner = lists[0]
    nested = inner if isinstance(inner, dict) else _categories(path, index, inner)
    return {name: value for name, value in row.items() if index_kind(name)} | nested


def _weights_key(row: dict[str, Any]) -> str | None:
    """Return the key of a row's nested weights; None if its values are the weights."""
    return next((key for key in _ROW_KEYS if isinstance(row.get(key), dict | list)), None)


def _ignored(row: Any) -> list[str]:
    """Return the keys of a row that are neither its weights nor its time."""
    key = _weights_key(row) if isinstance(row, dict) else None
    return [] if key is None else [name for name in row if name != key and not index_kind(name)]


def _categories(path: Path, index: int, row: list[Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for each in row:
        name = (
            each.get("categoryName", each.get("category_name")) if isinstance(each, dict) else None
        )
        if not isinstance(name, str) or "score" not in each:
            raise InputError(
                f"{path} row {index + 1}: holds {str(each)[:40]!r}; a list must be of "
                "{categoryName, score}, as MediaPipe writes"
            )
        if name != "_neutral":  # MediaPipe's first category is not a shape
            found[name] = each["score"]
    return found


def read_cell(path: Path, where: str, column: str, value: object) -> float:
    """Return the number in a cell of a table; refuse one that is not finite."""
    try:
        number = float(str(value)) if not isinstance(value, bool) else float("nan")
    except ValueError:
        number = float("nan")
    if not np.isfinite(number) or (index_kind(column) == "frame" and abs(number) >= MAX_FRAME):
        raise InputError(
            f"{path} {where}, column {column!r}: {value!r} is not a number; correct it"
        )
    return number


def _read_npy(path: Path, shapes: Path | None) -> WeightSamples:
    values = _load(path)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: holds {values.dtype} of shape {values.shape}; a matrix of frames by shapes "
            "is read"
        )
    names_file = shapes or next(
        (each for end in ("txt", "json", "npy") if (each := _names_path(path, end)).is_file()), None
    )
    if names_file is None:
        raise InputError(
            f"{path}: its {values.shape[1]} columns have no names; write them, one per line, to "
            f"{_names_path(path, 'txt').name} in the same folder, or give a file with --shapes"
        )
    names = _names(names_file)
    if len(names) != values.shape[1]:
        raise InputError(
            f"{names_file}: {len(names)} names for the {values.shape[1]} columns of {path}"
        )
    _check_unique(names_file, names)
    bad = np.argwhere(~np.isfinite(values.astype(np.float64)))
    if len(bad):
        row, column = bad[0].tolist()
        raise InputError(f"{path} row {row + 1}, {names[column]}: is not finite; export it again")
    lines = np.arange(1, len(values) + 1)
    return WeightSamples(tuple(names), values.astype(np.float64), lines)


def _names_path(path: Path, end: str) -> Path:
    return path.with_name(f"{path.stem}.names.{end}")


def _names(path: Path) -> list[str]:
    if path.suffix.lower() == ".npy":
        return [str(each) for each in _load(path).ravel().tolist()]
    if path.suffix.lower() == ".json":
        listed = read_json(path, _LARGEST_NAMES_BYTES)
        if not isinstance(listed, list):
            raise InputError(f"{path}: must be a list of names")
        return [str(each) for each in listed]
    text = read_text(path, _LARGEST_NAMES_BYTES)
    return [name.strip() for name in re.split(r"[\n,;]", text) if name.strip()]


def _load(path: Path) -> Any:
    check_may_open(path)
    try:  # mapped: a damaged header must not allocate more memory than the file has
        loaded = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, TypeError, KeyError, TokenError) as error:
        raise InputError(
            f"{path}: cannot be read as a NumPy array without pickled objects: {error}"
        ) from error
    if not isinstance(loaded, np.ndarray):
        raise InputError(f"{path}: is an archive of several arrays; save one of them with np.save")
    return loaded


def _check_unique(path: Path, names: Sequence[Any]) -> None:
    if twice := repeated(names):
        raise InputError(f"{path}: {first_few(twice)} is named twice; keep one")
