"""Validation messages: what is wrong with a value, and what to give instead."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP
from usdface.specs.paths import PRIM_PATTERN

PATTERN_WORDS = {
    r"^-?\d+--?\d+$": "give the first and the last frame, such as 101-240",
    r"^-?\d+(=.+)?$": "give a frame, or a frame and a name, such as 120=smile",
    r"^[^=]+=\d+$": "give a marker and a point of the mesh, such as nose_tip=1203",
    f"^{PRIM_PATTERN}$": "give the path of a prim, such as /shot/cast/hero",
    f"^(auto|{PRIM_PATTERN})$": "give auto or a camera's path, such as /Shot/main",
    r"^(\d\d:\d\d:\d\d[:;]\d\d)?$": "give hours, minutes, seconds and frames, such as 01:00:00:00",
}
"""Patterns of the specs, each with the advice for a value that does not match."""


def validation_messages(
    error: ValidationError, spec: type[Spec], *, places: Sequence[str] = ()
) -> str:
    """Return all faults of a spec as ``field -> sub[2]: reason``, one per line.

    Parameters
    ----------
    places : sequence of str
        Where each step stands in the file, if not in the order of `steps`.
    """
    lines = []
    for fault in _drop_secondary_errors(error.errors()):
        place, parts = "", fault["loc"]
        if places and len(parts) > 1 and parts[0] == "steps" and isinstance(parts[1], int):
            place, parts = places[parts[1]], parts[2:]
        for part in parts:
            place += f"[{part}]" if isinstance(part, int) else f"{' -> ' if place else ''}{part}"
        reason = _reason(fault, spec)
        lines.append(f"{place}: {reason}" if place else reason)
    lines = list(dict.fromkeys(lines))  # what is wrong in a loop over takes is wrong once
    if len(lines) == 1:
        return lines[0]
    return f"{len(lines)} faults\n" + "\n".join(f"  {line}" for line in lines)


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


def _reason(fault: Mapping[str, Any], spec: type[Spec]) -> str:
    """Return the reason of a fault and, in brackets, the value."""
    context = fault.get("ctx", {})
    if fault["type"] == "union_tag_invalid":
        known = [name.strip(" '") for name in str(context["expected_tags"]).split(",")]
        tag = str(context["tag"])
        return f"there is no step {tag!r}; {_did_you_mean(tag, known, 'steps are')}"
    if fault["type"] == "extra_forbidden":
        return _unknown_key(fault["loc"], spec)
    if fault["type"] == "string_pattern_mismatch":
        reason = PATTERN_WORDS.get(str(context["pattern"]), str(fault["msg"]))
    else:
        reason = str(fault["msg"]).removeprefix("Value error, ")
    given = fault.get("input")
    if isinstance(given, dict | list | tuple):
        return reason
    shown = str(given) if isinstance(given, Path) else given
    return f"{reason} (got {shown!r})"


def _unknown_key(location: Sequence[str | int], spec: type[Spec]) -> str:
    """Return the advice for a key that a spec does not have; a step's name stands before it."""
    name = str(location[-1])
    of_step = SPEC_BY_STEP.get(str(location[-2])) if len(location) > 1 else None
    owner = of_step or spec
    if name in owner.removed:
        return removed_message(name, owner)
    known = [field for field in owner.model_fields if field != "step"]
    return f"unknown key; {_did_you_mean(name, known, 'it can be')}"


def removed_message(name: str, spec: type[Spec]) -> str:
    """Return the message for a removed field."""
    return f"{spec.step_name()} has no {name} any more; {spec.removed[name]}"


def _did_you_mean(given: str, known: Sequence[str], otherwise: str) -> str:
    near = difflib.get_close_matches(given, known, n=3)
    return f"did you mean {' or '.join(near)}?" if near else f"{otherwise} {', '.join(known)}"
