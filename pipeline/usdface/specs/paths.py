"""Paths of a spec: mapped between machines, confined to a folder, checked by kind."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

from usdface.core.errors import InputError
from usdface.specs.base import IMAGE_SUFFIXES, FilePath, Reads, Spec, Writes

LARGEST_RULES_BYTES = 16 << 20
_FORMATS: dict[str, type[PurePath]] = {"POSIX": PurePosixPath, "WINDOWS": PureWindowsPath}


@dataclass(frozen=True)
class PathRule:
    """What lies below one folder on the submitting machine lies below another on this one.

    Attributes
    ----------
    source : PurePosixPath or PureWindowsPath
        In the submitting machine's manner, whatever this machine's is.
    destination : Path
    """

    source: PurePath
    destination: Path


PathRules = tuple[PathRule, ...]


def read_path_rules(path: Path) -> PathRules:
    """Read the rules that a farm's session hands to its tasks.

    Parameters
    ----------
    path : Path
        JSON, as ``{{Session.PathMappingRulesFile}}`` names it; ``{}`` where there are no rules.

    Returns
    -------
    tuple of PathRule
        The deepest source first: the first that fits a path is the one to use.

    Raises
    ------
    InputError
        If the file cannot be read or is no such document.
    """
    data = _read_document(path)
    if not data:
        return ()
    listed = data.get("path_mapping_rules")
    if data.get("version") != "pathmapping-1.0" or not isinstance(listed, list):
        raise InputError(
            f"{path}: version is {data.get('version')!r}; only 'pathmapping-1.0' with a list of "
            "path_mapping_rules is understood"
        )
    rules = [_rule(each, f"{path}: path_mapping_rules[{n}]") for n, each in enumerate(listed)]
    return tuple(sorted(rules, key=lambda rule: -len(rule.source.parts)))


def map_path(path: Path, rules: PathRules) -> Path:
    """Return where a path of the submitting machine lies here; without a rule, where it says."""
    for rule in rules:
        windows = isinstance(rule.source, PureWindowsPath)
        given = PureWindowsPath(str(path)) if windows else PurePosixPath(path.as_posix())
        if given.is_relative_to(rule.source):
            return rule.destination.joinpath(*given.relative_to(rule.source).parts)
    return path


def _read_document(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_RULES_BYTES:
            raise InputError(f"{path}: is too large for path mapping rules")
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no valid JSON: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: holds {type(data).__name__}, not path mapping rules")
    return data


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


VARIABLE = "USDFACE_ROOT"
"""Environment variable that confines every command and step: for a farm, or a service that runs
what others send."""


def confinement_root() -> Path | None:
    """Return the folder that the environment confines all work to; None where it does not."""
    told = os.environ.get(VARIABLE, "")
    return Path(told) if told else None


def check_confined(specs: tuple[Spec, ...], root: Path) -> None:
    """Refuse specs with a path outside a folder, by ``..``, by a link, or plainly.

    Links are followed, those of folders on the way included: what counts is where the file is.

    Raises
    ------
    InputError
        If the folder does not exist, or naming every path that lies outside.
    """
    check_paths_confined(
        [
            (spec.step, path)
            for spec in specs
            for path in dict.fromkeys((*spec.paths(Reads), *spec.paths(Writes), *spec.changes()))
        ],
        root,
    )


def check_paths_confined(paths: Sequence[tuple[str, Path]], root: Path) -> None:
    """Refuse paths outside a folder, as `check_confined` does.

    Parameters
    ----------
    paths : sequence of (str, Path)
        Each with the name of what reads or writes it.
    root : Path

    Raises
    ------
    InputError
        If the folder does not exist, or naming every path that lies outside.
    """
    if not root.is_dir():
        raise InputError(f"{root}: no such folder, so nothing can be confined to it")
    top = root.resolve()
    faults = []
    for what, path in paths:
        real = path.resolve()
        if not real.is_relative_to(top):
            plainly = Path(os.path.normpath(path.absolute()))  # a folder up is no link
            by = " (by a link)" if plainly.is_relative_to(top) else ""
            faults.append(f"{what}: {path}: lies outside {root}{by}, at {real}")
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files below it, or ask for another root")


def _one_or_several(given: Any) -> Any:
    return (given,) if isinstance(given, str | Path) else given


def _figures_or_curves(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    for path in paths:
        if path.suffix.lower() not in (".json", *IMAGE_SUFFIXES):
            raise ValueError(
                f"{path}: figures are written as .json, curves as {', '.join(IMAGE_SUFFIXES)}"
            )
    return paths


MeasuredOut = Annotated[
    tuple[FilePath, ...],
    BeforeValidator(_one_or_several),
    AfterValidator(_figures_or_curves),
    Writes(),
]
