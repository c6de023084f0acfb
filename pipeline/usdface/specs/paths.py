"""Paths and frames of specs: marks, checks and path mapping."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from usdface.core.errors import InputError
from usdface.core.sidecars import LAYER_SUFFIXES

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff")


@dataclass(frozen=True)
class Reads:
    """Marks a path that a step reads."""

    alone: bool = False
    """Whether only the file is read, without the layers it refers to."""
    assets: bool = False
    """Whether textures, movies, sounds and pictures of its layers are read as well."""
    sequence: bool = False
    """Whether a picture stands for all of its numbered sequence."""


@dataclass(frozen=True)
class Writes:
    """Marks a path that a step writes."""


def _names_a_file(path: Path) -> Path:
    if not path.name:
        raise ValueError(f"{str(path)!r} names no file; give the path of one")
    return path


FilePath = Annotated[Path, AfterValidator(_names_a_file)]
ReadPath = Annotated[FilePath, Reads()]
VideoPath = Annotated[FilePath, Reads(sequence=True)]
ShownPath = Annotated[FilePath, Reads(assets=True)]
WritePath = Annotated[FilePath, Writes()]


def file_ending(
    suffixes: tuple[str, ...], what: str, *, small_letters: bool = False
) -> Callable[[Path], Path]:
    """Return a validator of a path's suffix.

    `what`: the kind of file, as "a picture". `small_letters`: whether capital ones are refused.
    """

    def check(path: Path) -> Path:
        if (path.suffix if small_letters else path.suffix.lower()) not in suffixes:
            raise ValueError(f"{what} is written, so the name must end in {', '.join(suffixes)}")
        return path

    return check


_layer_ending = file_ending(LAYER_SUFFIXES, "a USD layer", small_letters=True)

LayerOut = Annotated[WritePath, AfterValidator(_layer_ending)]
ImageOut = Annotated[WritePath, AfterValidator(file_ending(IMAGE_SUFFIXES, "a picture"))]


def _one_or_several(given: Any) -> Any:
    return (given,) if isinstance(given, str | Path | int | float) else given


Several = BeforeValidator(_one_or_several)
"""Marks a list that may be given as a single item."""


def _figures_or_curves(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    for path in paths:
        if path.suffix.lower() not in (".json", *IMAGE_SUFFIXES):
            raise ValueError(
                f"{path}: figures are written as .json, curves as {', '.join(IMAGE_SUFFIXES)}"
            )
    return paths


MeasuredOut = Annotated[tuple[FilePath, ...], Several, AfterValidator(_figures_or_curves), Writes()]

PRIM_PATTERN = r"(/[^\x00-@\[-^`{-\x7f][^\x00-/:-@\[-^`{-\x7f]*)+"
"""Prim paths in any script, as in USD; `prim_path` checks the names with `str.isidentifier`."""


def prim_path(path: str) -> str:
    """Return the path of a prim; refuse paths that are invalid in USD."""
    if not all(name.isidentifier() for name in path.split("/")[1:]):
        raise ValueError("give the path of a prim, such as /shot/cast/hero")
    return path


PrimPath = Annotated[str, Field(pattern=f"^{PRIM_PATTERN}$"), AfterValidator(prim_path)]

FRAMES_PATTERN = r"^-?\d+--?\d+$"


_FARTHEST_FRAME = 10**9
"""As in notes of a review."""


def _in_order(frames: str) -> str:
    first, last = _split_frames(frames)
    _check_near(first, last)
    if last < first:
        raise ValueError(f"the last frame, {last}, precedes the first, {first}; swap them")
    return frames


Frames = Annotated[
    str, Field(pattern=FRAMES_PATTERN, examples=["101-240"]), AfterValidator(_in_order)
]


def _check_near(*frames: int) -> None:
    if far := [frame for frame in frames if abs(frame) > _FARTHEST_FRAME]:
        raise ValueError(f"frame {far[0]} is beyond {_FARTHEST_FRAME}; correct the number")


def _in_order_or_listed(frames: str) -> str:
    listed = frame_list(frames)
    if listed is None:
        return _in_order(frames)
    _check_near(*listed)
    return frames


ChosenFrames = Annotated[
    str,
    Field(
        pattern=rf"{FRAMES_PATTERN}|^-?\d+(,-?\d+)*$",
        max_length=10_000,
        examples=["101-240", "1,434,1182"],
    ),
    AfterValidator(_in_order_or_listed),
]


def frame_list(frames: str | None) -> tuple[int, ...] | None:
    """Turn ``"1,434,1182"`` into (1, 434, 1182); None of a range and of None."""
    if frames is None or re.search(r"\d-", frames):
        return None
    return tuple(sorted({int(frame) for frame in frames.split(",")}))


def frame_range(frames: str | None) -> tuple[int, int] | None:
    """Turn ``"101-240"`` into (101, 240); None stays None."""
    return None if frames is None else _split_frames(frames)


def _split_frames(frames: str) -> tuple[int, int]:
    split = frames.index("-", 1)
    return int(frames[:split]), int(frames[split + 1 :])


LARGEST_RULES_BYTES = 16 << 20
_FORMATS: dict[str, type[PurePath]] = {"POSIX": PurePosixPath, "WINDOWS": PureWindowsPath}


@dataclass(frozen=True)
class PathRule:
    """A folder on the submitting machine and the same folder on this one."""

    source: PurePath
    """With the separators of the submitting machine."""
    destination: Path


PathRules = tuple[PathRule, ...]


def read_path_rules(path: Path) -> PathRules:
    """Read Open Job Description's ``Session.PathMappingRulesFile``, the deepest source first."""
    try:
        if path.stat().st_size > LARGEST_RULES_BYTES:
            raise InputError(f"{path}: is too large for path mapping rules")
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no valid JSON: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: holds {type(data).__name__}, not path mapping rules")
    if not data:
        return ()
    listed = data.get("path_mapping_rules")
    if data.get("version") != "pathmapping-1.0" or not isinstance(listed, list):
        raise InputError(
            f"{path}: version is {data.get('version')!r}; only 'pathmapping-1.0' with a list of "
            "path_mapping_rules is supported"
        )
    rules = [_rule(each, f"{path}: path_mapping_rules[{n}]") for n, each in enumerate(listed)]
    return tuple(sorted(rules, key=lambda rule: -len(rule.source.parts)))


def map_path(path: Path, rules: PathRules) -> Path:
    """Return a path of the submitting machine mapped to this one; unchanged if no rule applies."""
    for rule in rules:
        windows = isinstance(rule.source, PureWindowsPath)
        given = PureWindowsPath(str(path)) if windows else PurePosixPath(path.as_posix())
        if given.is_relative_to(rule.source):
            return rule.destination.joinpath(*given.relative_to(rule.source).parts)
    return path


def _rule(given: Any, where: str) -> PathRule:
    if not isinstance(given, dict):
        raise InputError(f"{where}: is {given!r}, not a rule")
    kind = _FORMATS.get(str(given.get("source_path_format", "")).upper())
    source, destination = given.get("source_path"), given.get("destination_path")
    if kind is None or not isinstance(source, str) or not isinstance(destination, str):
        raise InputError(
            f"{where}: needs source_path_format (POSIX or WINDOWS), source_path and "
            f"destination_path, got {given!r}"
        )
    return PathRule(kind(source), Path(destination))
