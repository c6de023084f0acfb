"""Read specs from YAML or JSON, and write them."""

import contextlib
import difflib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from usdface.core.errors import InputError
from usdface.core.text import json_text
from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP, JobSpec
from usdface.specs.paths import PRIM_PATTERN, PathRules, map_path
from usdface.specs.takes import QUOTE_IT, step_places

if TYPE_CHECKING:
    import yaml

PATTERN_WORDS = {
    r"^-?\d+--?\d+$": "give the first and the last frame, such as 101-240",
    r"^-?\d+--?\d+$|^-?\d+(,-?\d+)*$": "give the first and the last frame, such as 101-240, or "
    "frames, such as 1,434,1182",
    r"^-?\d+(=.+)?$": "give a frame, or a frame and a name, such as 120=smile",
    r"^[^=]+=\d+$": "give a marker and a point of the mesh, such as nose_tip=1203",
    f"^{PRIM_PATTERN}$": "give the path of a prim, such as /shot/cast/hero",
    f"^(auto|front|{PRIM_PATTERN})$": "give auto, front or a camera's path, such as /Shot/main",
    r"^(\d\d:\d\d:\d\d[:;]\d\d)?$": "give hours, minutes, seconds and frames, such as 01:00:00:00",
}
"""Patterns of the specs, each with the advice for a value that does not match."""

FAULT_WORDS = {
    "missing": "is missing; give it",
    "tuple_type": "give a list, such as [a, b]",
    "list_type": "give a list, such as [a, b]",
    "too_short": "give {min_length} or more",
    "too_long": "give at most {max_length}",
    "int_type": "give a whole number",
    "int_parsing": "give a whole number",
    "int_parsing_size": "give a smaller number",
    "int_from_float": "give a whole number",
    "float_type": "give a number",
    "float_parsing": "give a number",
    "finite_number": "give a finite number",
    "bool_type": "give true or false",
    "bool_parsing": "give true or false",
    "string_type": f"give a text; {QUOTE_IT}",
    "string_unicode": "give a text that is valid Unicode",
    "string_too_short": "give {min_length} or more characters",
    "string_too_long": "give at most {max_length} characters",
    "path_type": f"give the path of a file; {QUOTE_IT}",
    "invalid_key": f"give a name; {QUOTE_IT}",
    "greater_than": "give more than {gt}",
    "greater_than_equal": "give {ge} or more",
    "less_than": "give less than {lt}",
    "less_than_equal": "give {le} or less",
    "union_tag_not_found": "a step is a table with its name as `step`, such as {{step: map}}",
    "model_attributes_type": "give a table of options",
    "model_type": "give a table of options",
    "dict_type": "give a table of options",
}
"""Advice for each kind of pydantic's errors."""


def validation_messages(
    error: ValidationError, spec: type[Spec], *, places: Sequence[str] = ()
) -> str:
    """Return all faults of a spec as ``step 2, select -> count: reason``, one per line.

    Steps and items of lists count from 1.

    `places`: position of each step in the file, if it differs from the index in `steps`.
    """
    lines = []
    for fault in _drop_secondary_errors(error.errors()):
        place = _fault_location(fault["loc"], places)
        reason = fault_reason(fault, spec)
        lines.append(f"{place}: {reason}" if place else reason)
    lines = list(dict.fromkeys(lines))  # a fault in a loop over takes occurs once per take
    if len(lines) == 1:
        return lines[0]
    return f"{len(lines)} faults\n" + "\n".join(f"  {line}" for line in lines)


def _fault_location(location: Sequence[str | int], places: Sequence[str]) -> str:
    """Return step and option of a fault."""
    parts, place = list(location), ""
    if len(parts) > 1 and parts[0] == "steps" and isinstance(parts[1], int):
        index = parts[1]
        place = places[index] if index < len(places) else f"step {index + 1}"
        place += f", {parts[2]}" if len(parts) > 2 else ""
        parts = parts[3:]
    for part in parts:
        if isinstance(part, int):
            place += f" {part + 1}"
        else:
            place += f"{' -> ' if place else ''}{part}"
    return place


def _drop_secondary_errors(faults: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the faults without those that follow from others, such as a list left empty."""
    faults = list(faults)
    return [
        fault
        for fault in faults
        if not (
            fault["type"] == "too_short"
            and any(
                other["loc"][: len(fault["loc"])] == fault["loc"] and other is not fault
                for other in faults
            )
        )
    ]


def fault_reason(fault: Mapping[str, Any], spec: type[Spec] = Spec) -> str:
    """Return the reason of a fault that pydantic found and, in brackets, the value."""
    context = fault.get("ctx", {})
    if fault["type"] == "union_tag_invalid":
        known = [name.strip(" '") for name in str(context["expected_tags"]).split(",")]
        tag = str(context["tag"])
        return f"there is no step {tag!r}; {_did_you_mean(tag, known, 'steps are')}"
    if fault["type"] == "extra_forbidden":
        return _unknown_key(fault["loc"], spec)
    given = fault.get("input")
    if fault["type"] == "literal_error":
        allowed = str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        quoted = "; in quotes, as YAML reads yes, no, on and off as true or false"
        remedy = _did_you_mean(str(given), allowed) + (quoted if isinstance(given, bool) else "")
        return f"{remedy} (got {given!r})"
    if fault["type"] == "string_pattern_mismatch":
        reason = PATTERN_WORDS.get(str(context["pattern"]), str(fault["msg"]))
    elif fault["type"] in FAULT_WORDS:
        reason = FAULT_WORDS[fault["type"]].format(**context)
    else:
        reason = str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "missing" or isinstance(given, dict | list | tuple):
        return reason
    shown = str(given) if isinstance(given, Path) else given
    return reason if repr(shown) in reason else f"{reason} (got {shown!r})"


def _unknown_key(location: Sequence[str | int], spec: type[Spec]) -> str:
    """Return the advice for an unknown key; in a job, a step's name precedes it in `location`."""
    name = str(location[-1])
    of_step = SPEC_BY_STEP.get(str(location[-2])) if len(location) > 1 else None
    owner = of_step or spec
    known = [field for field in owner.model_fields if field != "step"]
    return f"unknown key; {_did_you_mean(name, known, 'it can be')}"


def _did_you_mean(given: str, known: Sequence[str], otherwise: str = "it can be") -> str:
    near = difflib.get_close_matches(given, known, n=3)
    return f"did you mean {' or '.join(near)}?" if near else f"{otherwise} {', '.join(known)}"


LARGEST_SPEC_BYTES = 16 << 20
"""Limit of the size of a spec; jobs of thousands of steps are far smaller."""

MOST_VALUES = 1_000_000
"""Limit of values; YAML aliases can expand a few lines to billions."""

_OTHER_BASE = re.compile(r"[-+]?0[0-7_]+|.*:.*")
"""A number that YAML reads with base 8 or 60."""


def read_job(path: Path, *, path_rules: PathRules = ()) -> JobSpec:
    """Read a job, or a single step as a job; paths are resolved against the job's folder.

    `path_rules` map paths of the machine that wrote the job to paths of this one.
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
        return json_text(data)
    import yaml  # not at the top, so that --help starts faster

    return str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100))


def _as_written(spec: Spec) -> dict[str, Any]:
    """Return a spec's data, the step's name first, without defaults."""
    if isinstance(spec, JobSpec):
        return {"job": spec.job, "steps": [_as_written(step) for step in spec.steps]}
    return {"step": spec.step, **spec.model_dump(mode="json", exclude_defaults=True)}


def _read_data(path: Path) -> Any:
    import yaml

    try:
        if path.stat().st_size > LARGEST_SPEC_BYTES:
            raise InputError(
                f"{path}: {path.stat().st_size} bytes are too large for a spec; split the job"
            )
        if not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: is a pipe or a device; write the spec to a file")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is no YAML or JSON, as a job or spec is: not UTF-8 at byte {error.start}"
        ) from error
    # As YAML, JSON must not have tabs, nor characters of two surrogates.
    with contextlib.suppress(ValueError, RecursionError):
        return json.loads(text, object_pairs_hook=_table_of_json)
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        _count_values(node, {})  # before aliases and merged tables are expanded
        data = None if node is None else loader.construct_document(node)
    except yaml.YAMLError as error:
        raise InputError(f"{path}: is no valid YAML or JSON: {_yaml_reason(error)}") from error
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply for a spec") from error
    except (ValueError, LookupError, AttributeError) as error:  # a malformed number or date
        raise InputError(f"{path}: holds a value that cannot be read: {error}") from error
    return data


def _table_of_json(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a table; `ValueError` if a key is given twice, whose place YAML's parser names."""
    if len(dict(pairs)) < len(pairs):
        raise ValueError
    return dict(pairs)


def _count_values(node: "yaml.Node | None", counts: dict[int, int]) -> int:
    """Return the number of values that a node stands for.

    Refuses too many, keys given twice in one table, of which YAML would use the last, and numbers
    that YAML reads with another base than 10.
    """
    import yaml

    numbers = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
    if node and node.tag in numbers and _OTHER_BASE.fullmatch(node.value):
        base = 60 if ":" in node.value else 8
        problem = (
            f"YAML reads {node.value} with base {base}; write a number with base 10 and no 0 "
            "before it, or quote it if it is text"
        )
        raise yaml.MarkedYAMLError(None, None, problem, node.start_mark)
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) in counts:  # aliases share nodes
        return counts[id(node)]
    counts[id(node)] = MOST_VALUES  # if it holds itself
    inner = node.value
    if isinstance(node, yaml.MappingNode):
        keys = set[tuple[str, str]]()
        for key, _ in node.value:
            name = key.tag, str(key.value) if isinstance(key, yaml.ScalarNode) else str(id(key))
            if name in keys and key.tag != "tag:yaml.org,2002:merge":
                problem = f"{key.value} is given twice in one table; keep one"
                raise yaml.MarkedYAMLError(None, None, problem, key.start_mark)
            keys.add(name)
        inner = [each for pair in node.value for each in pair]
    counts[id(node)] = count = 1 + sum(_count_values(each, counts) for each in inner)
    if count > MOST_VALUES:
        problem = f"stands for more than {MOST_VALUES} values; split the job"
        raise yaml.MarkedYAMLError(None, None, problem, node.start_mark)
    return count


def _yaml_reason(error: "yaml.YAMLError") -> str:
    """Return the reason of a YAML error, with line and column counted from 1."""
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    if mark is None or not problem:
        return " ".join(str(error).replace("<unicode string>", "the file").split())
    return f"line {mark.line + 1}, column {mark.column + 1}: {problem}"
