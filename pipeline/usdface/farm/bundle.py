"""Job bundles for farms (Open Job Description, jobtemplate-2023-09); equal jobs give equal bytes.

The template contains no names given by users: tasks are numbered and find their spec in a file of
the bundle, so that no name can be evaluated as ``{{an expression}}`` or as part of a command. The
job's name is the value of a parameter, which is not evaluated.
"""

import hashlib
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from usdface.core.errors import InputError
from usdface.core.write_lock import write_lock
from usdface.farm.plan import FarmStep
from usdface.specs.paths import Reads, Writes
from usdface.specs.reading import spec_text

TASKS_FOLDER = "tasks"
"""Folder of the bundle with the tasks' specs, STEP/NUMBER.yaml."""

LONGEST_JOB_NAME = 128
NOTIFY_SECONDS = 30
"""Time from SIGTERM to the end of a task, for the removal of temporary files."""


def job_template(name: str, steps: Sequence[FarmStep]) -> dict[str, Any]:
    """Return the template of a job. `name`: shown on the farm, verbatim."""
    if not name.isprintable() or not name.strip() or len(name) > LONGEST_JOB_NAME:
        raise InputError(
            f"job: {name!r} cannot name a job on a farm; give it 1 to {LONGEST_JOB_NAME} "
            "printable characters"
        )
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": "{{Param.Job}}",
        "description": "Facial capture to BlendShape weights. Every task can be retried.",
        "parameterDefinitions": [
            {
                "name": "Job",
                "type": "STRING",
                "description": "The job's name.",
                "default": name,
                "userInterface": {"control": "LINE_EDIT", "label": "Job"},
            },
            {
                "name": "Tasks",
                "type": "PATH",
                "description": "The specs of the tasks, STEP/NUMBER.yaml.",
                "objectType": "DIRECTORY",
                "dataFlow": "IN",
                "default": TASKS_FOLDER,
                "userInterface": {"control": "HIDDEN"},
            },
        ],
        "steps": [_step(step) for step in steps],
    }


def task_command(spec: str) -> list[str]:
    """Return the command line of a task, as arguments."""
    return ["usdface", "run", spec, "--make-folders", "--progress", "openjd"]


def _step(step: FarmStep) -> dict[str, Any]:
    command, *arguments = task_command(
        f"{{{{Param.Tasks}}}}/{step.name}/{{{{Task.Param.Task}}}}.yaml"
    )
    written: dict[str, Any] = {"name": step.name}
    if step.needs:
        written["dependencies"] = [{"dependsOn": name} for name in step.needs]
    count = len(step.tasks)
    task = {"name": "Task", "type": "INT", "range": "1" if count == 1 else f"1-{count}"}
    return written | {
        "parameterSpace": {"taskParameterDefinitions": [task]},
        "hostRequirements": {
            "amounts": [
                {"name": "amount.worker.vcpu", "min": step.kind.cores},
                {"name": "amount.worker.memory", "min": step.kind.memory_mib},
            ]
        },
        "script": {
            "actions": {
                "onRun": {
                    "command": command,
                    "args": [*arguments, "--path-mapping", "{{Session.PathMappingRulesFile}}"],
                    "cancelation": {
                        "mode": "NOTIFY_THEN_TERMINATE",
                        "notifyPeriodInSeconds": NOTIFY_SECONDS,
                    },
                }
            }
        },
    }


TEMPLATE_FILE = "template.yaml"
FIRST_LINE = "# Written by `usdface submit`; submit again rather than change it.\n"

Files = Mapping[str, str]
"""Text of each file by its path in the bundle."""


def compose_bundle(
    name: str, steps: Sequence[FarmStep], *, carried: Iterable[Path] = ()
) -> dict[str, str]:
    """Return the contents of a bundle's files, by path.

    Parameters
    ----------
    steps : sequence of FarmStep
        With absolute paths.
    carried : iterable of Path
        Input files that no task makes, which a farm without shared storage copies to its workers.
    """
    files = {TEMPLATE_FILE: FIRST_LINE + _yaml(job_template(name, steps))}
    files["asset_references.yaml"] = FIRST_LINE + _yaml(_asset_references(steps, carried))
    for step in steps:
        for number, task in enumerate(step.tasks, start=1):
            place = f"{TASKS_FOLDER}/{step.name}/{number}.yaml"
            files[place] = spec_text(task, Path(place))
    return files


def bundle_hash(files: Files) -> str:
    """Return eight hex digits of the hash of a bundle."""
    total = hashlib.sha256()
    for place, text in sorted(files.items()):
        total.update(f"{place}\0{len(text)}\0{text}".encode())
    return total.hexdigest()[:8]


def write_bundle(folder: Path, files: Files, *, overwrite: bool = False) -> None:
    """Write a bundle atomically; an equal one is kept.

    `InputError` if the folder cannot be written, or holds something else, or without `overwrite`
    another bundle.
    """
    if _equals(folder, files):
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        if not _is_bundle(folder):
            raise InputError(f"{folder}: exists and is not a bundle; choose another --out")
        if not overwrite:
            raise InputError(
                f"{folder}: holds the bundle of another job, which may still be running; choose "
                "another --out, or --overwrite it"
            )
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist; make it first")
    with write_lock(folder):
        _put(folder, files)


def _put(folder: Path, files: Files) -> None:
    """Write a bundle to a temporary folder, then swap the two."""
    made = folder.with_name(f".{folder.name}.bundle")
    shutil.rmtree(made, ignore_errors=True)  # left by a killed process
    old, new = made / "old", made / "new"
    try:
        made.mkdir()
        for place, text in files.items():
            file = new / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8", newline="\n")
        if folder.exists():
            folder.rename(old)
        try:
            new.rename(folder)
        except BaseException:
            if not folder.exists():
                old.rename(folder)
            raise
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _equals(folder: Path, files: Files) -> bool:
    try:
        there = {
            str(path.relative_to(folder)).replace(os.sep, "/"): path
            for path in filter(Path.is_file, folder.rglob("*"))
        }
        return set(there) == set(files) and all(
            path.read_text(encoding="utf-8") == files[place] for place, path in there.items()
        )
    except (OSError, UnicodeDecodeError):
        return False


def _is_bundle(folder: Path) -> bool:
    try:
        return (folder / TEMPLATE_FILE).read_text(encoding="utf-8").startswith(FIRST_LINE)
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
