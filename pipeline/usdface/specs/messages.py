"""What is wrong with a value, in words that tell what to give instead."""

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from usdface.specs.base import PRIM_PATTERN

PATTERN_WORDS = {
    r"^-?\d+--?\d+$": "give the first and the last frame, such as 101-240",
    r"^-?\d+(=.+)?$": "give a frame, or a frame and a name, such as 120=smile",
    r"^[^=]+=\d+$": "give a marker and a point of the mesh, such as nose_tip=1203",
    f"^{PRIM_PATTERN}$": "give the path of a prim, such as /shot/cast/hero",
    f"^(auto|{PRIM_PATTERN})$": "give auto or a camera's path, such as /Shot/main",
    r"^(cpu|torch|cuda(:\d+)?)$": "give cpu, torch, cuda or, of several cards, cuda:1",
    r"^(\d\d:\d\d:\d\d[:;]\d\d)?$": "give hours, minutes, seconds and frames, such as 01:00:00:00",
}
"""The patterns of the specs, and what to say to who missed one."""


def drop_secondary_errors(faults: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the faults that a person made; a list that others left empty is none of them."""
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


def validation_message(fault: Mapping[str, Any]) -> str:
    """Return the reason of one fault and, in brackets, the value given."""
    context = fault.get("ctx", {})
    if fault["type"] == "union_tag_invalid":
        return _no_such_step(str(context["tag"]), str(context["expected_tags"]))
    if fault["type"] == "string_pattern_mismatch":
        reason = PATTERN_WORDS.get(str(context["pattern"]), str(fault["msg"]))
    else:
        reason = str(fault["msg"]).removeprefix("Value error, ")
    given = fault.get("input")
    if isinstance(given, dict | list | tuple):
        return reason
    shown = str(given) if isinstance(given, Path) else given
    return f"{reason} (got {shown!r})"


def _no_such_step(given: str, expected: str) -> str:
    known = [name.strip(" '") for name in expected.split(",")]
    near = difflib.get_close_matches(given, known, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"steps are {', '.join(known)}"
    return f"there is no step {given!r}; {hint}"
