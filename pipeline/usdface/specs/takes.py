"""Jobs of many takes: steps under ``for_each: take`` are expanded for each take.

::

    takes: [kitchen_001, kitchen_002, {take: kitchen_003, neutral: 88}]
    steps:
      - for_each: take
        steps:
          - {step: ingest, sources: ["{take}.c3d"], out: "{take}.take.usda"}
          - {step: clean, take: "{take}.take.usda", out: "{take}.clean.take.usda"}
      - {step: select, takes: ["{take}.clean.take.usda"], rig: hero.usd, out: hero.references.usda}

Steps inside ``for_each: take`` run once per take. Other steps run once, and a list item that
contains a take's value is repeated for every take. ``{{`` and ``}}`` are literal braces.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

_MOST_STEPS = 100_000
"""Limit of steps; a shooting day has a few thousand."""

_PLACE = re.compile(r"\{\{|\}\}|\{([A-Za-z_][A-Za-z0-9_]*)\}")
_TAKE_NAME = re.compile(r"[^\x00-\x1f\x7f/\\]{1,200}")

QUOTE_IT = "quote a name that YAML reads as a number, a date, true or false"

Row = Mapping[str, Any]

TAKES_SCHEMA: dict[str, Any] = {
    "type": "array",
    "minItems": 1,
    "description": "Takes to run steps for: names, or tables of values with the name as `take`. "
    "`{take}` and `{KEY}` are replaced by the values.",
    "items": {
        "anyOf": [
            {"type": "string"},
            {
                "type": "object",
                "required": ["take"],
                "properties": {"take": {"type": "string"}},
                "additionalProperties": {"type": ["string", "number", "boolean"]},
            },
        ]
    },
}
"""JSON Schema of ``takes``, for editors."""

FOR_EACH_SCHEMA: dict[str, Any] = {
    "type": "object",
    "description": "Steps to run once per take.",
    "required": ["for_each", "steps"],
    "additionalProperties": False,
    "properties": {
        "for_each": {"const": "take"},
        "steps": {
            "type": "array",
            "minItems": 1,
            "items": {
                "type": "object",
                "required": ["step"],
                "properties": {"step": {"type": "string"}},
            },
        },
    },
}


def write_out(job: Mapping[str, Any]) -> dict[str, Any]:
    """Return a job's data with its takes expanded to plain steps; unchanged if it has none."""
    written = dict(job)
    given = written.pop("takes", None)
    steps = written.get("steps")
    if not isinstance(steps, Sequence) or isinstance(steps, str):
        return written
    if given is None:
        if any(_is_loop(step) for step in steps):
            raise ValueError(
                "`for_each: take` needs `takes`, a list of takes, at the level of `steps`"
            )
        return written
    rows = _rows(given)
    done: list[Any] = []
    for number, step in enumerate(steps, start=1):
        if _is_loop(step):
            inner = _steps_of(step, number)
            if len(done) + len(rows) * len(inner) > _MOST_STEPS:
                raise ValueError(f"{len(rows)} takes make more than {_MOST_STEPS} steps; split it")
            done += [_filled(each, row, f"step {number}") for row in rows for each in inner]
        else:
            done.append(_repeated_per_take(step, rows, f"step {number}"))
    written["steps"] = done
    return written


def step_places(job: Mapping[str, Any]) -> list[str]:
    """Return the position in the file of each step of the job expanded by `write_out`.

    ``step 2.3`` is the third step of the loop that is the job's second item.
    """
    places: list[str] = []
    takes, steps = job.get("takes"), job.get("steps")
    if not isinstance(steps, list | tuple) or not isinstance(takes, list | tuple):
        return places
    for number, step in enumerate(steps, start=1):
        inner = step.get("steps") if _is_loop(step) else None
        count = len(inner) if isinstance(inner, list | tuple) else 0
        each = [f"step {number}.{within}" for within in range(1, count + 1)]
        places += each * len(takes) if each else [f"step {number}"]
    return places


def _is_loop(step: Any) -> bool:
    return isinstance(step, Mapping) and "for_each" in step


def _steps_of(loop: Mapping[str, Any], number: int) -> Sequence[Any]:
    where = f"step {number}"
    if loop["for_each"] != "take":
        raise ValueError(f"{where}: for_each is {loop['for_each']!r}; it can only be `take`")
    unknown = sorted(map(str, set(loop) - {"for_each", "steps"}))
    if unknown:
        raise ValueError(f"{where}: for_each allows only `steps`, not {', '.join(unknown)}")
    inner = loop.get("steps")
    if not isinstance(inner, Sequence) or isinstance(inner, str) or not inner:
        raise ValueError(f"{where}: for_each needs `steps`, a list of steps to run per take")
    return inner


def _rows(takes: Any) -> list[Row]:
    if not isinstance(takes, Sequence) or isinstance(takes, str) or not takes:
        raise ValueError("takes must be a list of names, or of tables with a `take` each")
    rows = [{"take": take} if isinstance(take, str) else take for take in takes]
    seen: set[str] = set()
    for number, row in enumerate(rows, start=1):
        where = f"take {number}"
        if not isinstance(row, Mapping) or not isinstance(row.get("take"), str):
            raise ValueError(
                f"{where}: must be a name, or a table with its name as `take`; {QUOTE_IT}"
            )
        name = row["take"]
        if not _TAKE_NAME.fullmatch(name) or name in (".", ".."):
            raise ValueError(
                f"{where}: {name!r} cannot name a take: give 1 to 200 printable characters without "
                "a slash"
            )
        if name in seen:
            raise ValueError(f"{where}: {name!r} is a duplicate; take names must be unique")
        seen.add(name)
        for key, value in row.items():
            if not isinstance(key, str) or not isinstance(value, str | int | float | bool):
                raise ValueError(f"{where}: {key!r} must be a text or a number, not {value!r}")
    return rows


def _filled(value: Any, row: Row, where: str) -> Any:
    """Return a value with the take's values filled in."""
    if isinstance(value, str):
        whole = _PLACE.fullmatch(value)
        if whole and whole[1]:  # a number stays a number
            return _look_up(row, whole[1], where)
        return _PLACE.sub(
            lambda found: (
                _as_text(_look_up(row, found[1], where), where) if found[1] else found[0][0]
            ),
            value,
        )
    if isinstance(value, Mapping):
        return {key: _filled(each, row, where) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_filled(each, row, where) for each in value]
    return value


def _as_text(value: Any, where: str) -> str:
    if isinstance(value, bool):
        raise ValueError(f"{where}: a text cannot contain {value}, a take's value; {QUOTE_IT}")
    return str(value)


def _repeated_per_take(value: Any, rows: list[Row], where: str) -> Any:
    """Return a step's value with list items that contain a take's value repeated per take."""
    if isinstance(value, Mapping):
        return {key: _repeated_per_take(each, rows, where) for key, each in value.items()}
    if isinstance(value, list | tuple):
        items: list[Any] = []
        for each in value:
            if isinstance(each, str) and _names_a_value(each):
                items += [_filled(each, row, where) for row in rows]
            else:
                items.append(_repeated_per_take(each, rows, where))
        return items
    if isinstance(value, str):
        if _names_a_value(value):
            raise ValueError(
                f"{where}: {value!r} differs between takes, but this step runs once; move it under "
                "`for_each: take`"
            )
        return _filled(value, {}, where)
    return value


def _names_a_value(text: str) -> bool:
    return any(found[1] for found in _PLACE.finditer(text))


def _look_up(row: Row, name: str, where: str) -> Any:
    if name not in row:
        raise ValueError(
            f"{where}: uses {{{name}}}, but take {row['take']!r} has only {', '.join(row)}; add "
            f"the value to the take, or write {{{{{name}}}}} for plain braces"
        )
    return row[name]
