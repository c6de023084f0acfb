"""Read specs from YAML or JSON, and write them."""

import json
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from usdface.core.errors import InputError
from usdface.specs.base import Spec
from usdface.specs.job import JobSpec
from usdface.specs.messages import validation_messages
from usdface.specs.paths import PathRules, map_path
from usdface.specs.takes import step_places

LARGEST_SPEC_BYTES = 16 << 20
"""Limit of the size of a spec; jobs of thousands of steps are far smaller."""


def read_job(path: Path, *, path_rules: PathRules = ()) -> JobSpec:
    """Read a job from a file; a single step makes a job of one.

    Parameters
    ----------
    path_rules : tuple of PathRule
        Where the paths of the machine that wrote the job lie on this one.

    Returns
    -------
    JobSpec
        Relative paths taken from the job's folder.

    Raises
    ------
    InputError
        If the file cannot be read, is no YAML or JSON, or does not validate; every fault is named.
    """
    data = _read_data(path)
    if not isinstance(data, dict):
        raise InputError(
            f"{path}: holds {type(data).__name__}, not a job; it needs `job` and `steps`"
        )
    if "step" in data and "steps" not in data:
        data = {"job": path.stem, "steps": [data]}
    try:
        job = JobSpec.model_validate(data)
    except ValidationError as error:
        written_out = "takes" in data and any(fault["loc"] for fault in error.errors())
        places = step_places(data) if written_out else ()
        reasons = validation_messages(error, JobSpec, places=places)
        raise InputError(f"{path}: {reasons}") from error

    def here(given: Path) -> Path:
        return path.parent / map_path(given, path_rules)

    return job.model_copy(update={"steps": tuple(step.with_paths(here) for step in job.steps)})


def spec_text(spec: Spec, path: Path) -> str:
    """Return a spec as the text of a file: JSON if the path ends so, otherwise YAML."""
    data = _as_written(spec)
    if path.suffix == ".json":
        return json.dumps(data, indent=2, ensure_ascii=False) + "\n"
    return str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100))


def _as_written(spec: Spec) -> dict[str, Any]:
    """Return a spec's data, the step's name first, without defaults."""
    if isinstance(spec, JobSpec):
        return {"job": spec.job, "steps": [_as_written(step) for step in spec.steps]}
    return {"step": spec.step, **spec.model_dump(mode="json", exclude_defaults=True)}


def _read_data(path: Path) -> Any:
    try:
        if path.stat().st_size > LARGEST_SPEC_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes are too large for a spec")
        if not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: is a pipe or a device; write the spec to a file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 at byte {error.start}; save it as UTF-8") from error
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: is no valid YAML or JSON: {reason}") from error
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply for a spec") from error
    except (ValueError, LookupError, AttributeError) as error:  # a number or a date that is none
        raise InputError(f"{path}: holds a value that cannot be read: {error}") from error
