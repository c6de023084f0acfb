"""A bundle: the folder that a farm is given. The same job makes the same bytes."""

import hashlib
import os
import shutil
import uuid
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import yaml

from usdface.core.errors import InputError
from usdface.farm.plan import FarmStep
from usdface.farm.template import TASKS, job_template
from usdface.specs.paths import Reads, Writes
from usdface.specs.reading import spec_text

TEMPLATE = "template.yaml"
MARK = "# Written by `usdface submit`; submit again rather than change it.\n"

Files = Mapping[str, str]
"""Text of each file by its path in the bundle."""


def compose_bundle(
    name: str, steps: Sequence[FarmStep], *, carried: Iterable[Path] = ()
) -> dict[str, str]:
    """Return what stands in a bundle's files.

    Parameters
    ----------
    name : str
        The job's.
    steps : sequence of FarmStep
        With absolute paths.
    carried : iterable of Path
        Files that the tasks read and that no task makes: a farm without shared storage copies them
        to its workers.

    Raises
    ------
    InputError
        If farms would refuse the job's name.
    """
    files = {TEMPLATE: MARK + _yaml(job_template(name, steps))}
    files["asset_references.yaml"] = MARK + _yaml(_asset_references(steps, carried))
    for step in steps:
        for number, task in enumerate(step.tasks, start=1):
            place = f"{TASKS}/{step.name}/{number}.yaml"
            files[place] = spec_text(task, Path(place))
    return files


def bundle_hash(files: Files) -> str:
    """Return eight hex digits that differ when anything in a bundle does."""
    total = hashlib.sha256()
    for place, text in sorted(files.items()):
        total.update(f"{place}\0{len(text)}\0{text}".encode())
    return total.hexdigest()[:8]


def write_bundle(folder: Path, files: Files, *, overwrite: bool = False) -> None:
    """Write a bundle; it appears whole or not at all, and one that is there already is kept.

    Raises
    ------
    InputError
        If the folder holds something else, or another bundle that `overwrite` does not allow to
        replace, or cannot be written.
    """
    if _equals(folder, files):
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        if not _is_bundle(folder):
            raise InputError(f"{folder}: exists and is no bundle; choose another --out")
        if not overwrite:
            raise InputError(
                f"{folder}: holds the bundle of another job, which may still be running; choose "
                "another --out, or --overwrite it"
            )
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist; make it first")
    temporary = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
    try:
        for place, text in files.items():
            file = temporary / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8", newline="\n")
        if folder.exists():
            shutil.rmtree(folder)
        temporary.rename(folder)
    except OSError as error:
        if not _equals(folder, files):  # else: the same job was submitted twice at the same moment
            raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _equals(folder: Path, files: Files) -> bool:
    try:
        there = {
            str(path.relative_to(folder)).replace(os.sep, "/"): path
            for path in _files_below(folder)
        }
        return set(there) == set(files) and all(
            path.read_text(encoding="utf-8") == files[place] for place, path in there.items()
        )
    except (OSError, UnicodeDecodeError):
        return False


def _files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def _is_bundle(folder: Path) -> bool:
    try:
        return (folder / TEMPLATE).read_text(encoding="utf-8").startswith(MARK)
    except (OSError, UnicodeDecodeError):
        return False


def _asset_references(steps: Sequence[FarmStep], carried: Iterable[Path]) -> dict[str, object]:
    tasks = [task for step in steps for task in step.tasks]
    made = {path for task in tasks for path in task.changes()}
    read = {path for task in tasks for path in task.paths(Reads)} - made
    folders = {path.parent for task in tasks for path in task.paths(Writes)}
    return {
        "assetReferences": {
            "inputs": {
                "filenames": sorted({str(path) for path in read | (set(carried) - made)}),
                "directories": [],
            },
            "outputs": {"directories": sorted(map(str, folders))},
            "referencedPaths": [],
        }
    }


def _yaml(data: object) -> str:
    return str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100))
