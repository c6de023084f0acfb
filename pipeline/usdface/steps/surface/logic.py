"""Define which shapes of a rig are driven by others."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, cast

from usdface.capture.text_table import csv_rows
from usdface.core.arrays import columns_by_name
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import Combination, CombinationMode, order_combinations
from usdface.core.text import first_few, pluralize, read_json
from usdface.numerics.regression.combination_inference import infer_combinations
from usdface.runner.result import StepResult
from usdface.specs.surface import LogicSpec
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_logic

_MOST_ROWS = 2000
"""Rows of weights used for inference, evenly spread."""

_LISTED_COMBINATIONS = 10


def run(spec: LogicSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Read the logic, check it against the rig and write an asset over the rig."""
    rig = read_rig(spec.rig, prim=spec.prim)
    shapes = (*rig.shapes, *(each.shape for each in rig.combinations))
    sources = []
    if spec.naming:
        sources.append(combinations_of_names(shapes))
    if spec.definition is not None:
        sources.append(read_definition(spec.definition))
    notes = []
    if spec.weights is not None:
        inferred, note = _inferred(spec, spec.weights, shapes)
        sources.append(inferred)
        notes.append(note)
    new = merged(sources)
    if not new:
        raise InputError(
            f"{spec.rig}: none of its {pluralize(len(shapes), 'shape')} is a combination by the "
            "given sources; nothing was written. Give another source"
        )
    stated = {each.shape for each in new}
    kept = [each for each in rig.combinations if each.shape not in stated]
    every = order_combinations((*new, *kept), shapes, source=spec.definition or spec.rig)
    write_logic(spec.out, rig, every, provenance=provenance)
    driven, rest = {each.shape for each in every}, len(every) - _LISTED_COMBINATIONS
    more = [f"and {rest} more; --json lists all"] if rest > 0 else []
    return StepResult(
        (spec.out,),
        f"{pluralize(len(every), 'combination')}; {len(shapes) - len(driven)} of "
        f"{pluralize(len(shapes), 'shape')} are animated",
        (*notes, *map(str, every[:_LISTED_COMBINATIONS]), *more),
        {"combinations": [_figures(each) for each in every]},
    )


def _figures(combination: Combination) -> dict[str, object]:
    return {
        "shape": combination.shape,
        "parts": list(combination.parts),
        "mode": combination.mode,
        "weights": list(combination.part_weights),
        "spans": [list(span) for span in combination.spans],
    }


def _inferred(
    spec: LogicSpec, weights: Path, shapes: tuple[str, ...]
) -> tuple[tuple[Combination, ...], str]:
    """Infer the logic of the shapes of --driven from weights."""
    driven = [name for name in shapes if any(fnmatchcase(name, each) for each in spec.driven)]
    if not driven:
        raise InputError(
            f"{spec.rig}: --driven matches none of its shapes ({first_few(shapes, most=3)}); name "
            "the driven shapes"
        )
    table = read_weight_table(weights, known=shapes, unit=spec.weight_unit, take=None)
    table.shapes_among(driven, file=weights, owner="among those driven")
    rows = table.weights[:: -(-len(table.weights) // _MOST_ROWS)]
    free = tuple(name for name in shapes if name not in driven and name in table.names)
    found = infer_combinations(
        free,
        columns_by_name(rows, table.names, free),
        driven,
        columns_by_name(rows, table.names, driven),
    )
    left = [name for name in driven if name not in {each.shape for each in found}]
    note = f"inferred {len(found)} of {len(driven)} from {pluralize(len(rows), 'row')}"
    if left:
        note += f"; {first_few(left)} stay animated, as they are at rest or follow no known rule"
    return found, note


_LARGEST_BYTES = 1 << 26
"""Limit of a definition's size; a rig of a thousand shapes needs a few MB."""

_MOST_SPLITS = 1 << 12
"""Limit of the number of ways to split a name."""

_SIDE = re.compile(r"_(?:[LRlr]|[Ll]eft|[Rr]ight)$")
_INBETWEEN = re.compile(r"(?P<part>.+?)_?(?P<percent>[1-9][05])$")
"""A shape whose name ends in a percentage, a multiple of 5, at which it has full effect."""

_SIMPLEX_MODES: dict[str, CombinationMode] = {
    "None": "minimum",
    "min": "minimum",
    "allMul": "product",
    "extMul": "product",
    "mulAvgExt": "smooth",
    "mulAvgAll": "smooth",
}
"""For two parts; for more parts only min and allMul are supported."""


def combinations_of_names(shapes: Sequence[str]) -> tuple[Combination, ...]:
    """Read combinations from names: ``A_B`` and ``A__B`` where all parts are shapes of the rig.

    A side at the end belongs to every part that has it (``smile_jaw_L`` is ``smile_L`` and
    ``jaw``), and ``A50`` is the in-between of A at 0.5.
    """
    prefix = _common_prefix(shapes)
    known = {name.removeprefix(prefix): name for name in shapes}
    found = []
    for short, name in known.items():
        ways = {frozenset(way): way for way in _splits(short, known)}
        finest = max(map(len, ways.values()), default=0)
        best = [way for way in ways.values() if len(way) == finest]
        if len(best) > 1:
            raise InputError(
                f"{name} is ambiguous: {' or '.join(' and '.join(way) for way in best)}; state it "
                "in a table (--definition)"
            )
        between = _INBETWEEN.fullmatch(short)
        if best:
            found.append(Combination(name, tuple(known[part] for part in best[0])))
        elif between is not None and between["part"] in known:
            at = int(between["percent"]) / 100
            found.append(Combination(name, (known[between["part"]],), weights=(at,)))
        else:
            _check_parts(name, short, known)
    return tuple(found)


def _check_parts(name: str, short: str, known: dict[str, str]) -> None:
    """Refuse a name of two shapes, ``A__B``, of which the rig has only one."""
    side = _SIDE.search(short)
    ending = side.group() if side else ""
    pieces = [each for each in short.removesuffix(ending).split("__") if each.strip("_")]
    there = [not known.keys().isdisjoint((each.strip("_"), each + ending)) for each in pieces]
    if any(there) and not all(there):
        missing = pieces[there.index(False)]
        raise InputError(
            f"{name}: {missing} is no shape of the rig, so the name is no combination; rename it, "
            "or state it in a table (--definition)"
        )


def _common_prefix(shapes: Sequence[str]) -> str:
    """Return the common prefix of all names, up to an underscore."""
    first, last = min(shapes, default=""), max(shapes, default="")
    count = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    return first[: first.rfind("_", 0, count) + 1]


def _splits(name: str, known: dict[str, str]) -> Iterator[tuple[str, ...]]:
    """Yield the ways to split a name into two or more shapes."""
    side = _SIDE.search(name)
    pieces = name.split("_")
    for ending in ("",) if side is None else ("", side.group()):
        own = pieces[:-1] if ending else pieces
        ways: list[list[tuple[str, ...]]] = [[()]]
        for stop in range(1, len(own) + 1):
            here = []
            for start in range(stop):
                text = "_".join(own[start:stop]).strip("_")
                part = next((each for each in (text + ending, text) if each in known), None)
                if part is not None and part != name:
                    here += [(*way, part) for way in ways[start]][:_MOST_SPLITS]
                elif not text:
                    here += ways[start][:_MOST_SPLITS]
            ways.append(here)
        yield from (way for way in ways[-1] if len(set(way)) == len(way) > 1)


_WRONG_TYPES = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What values of other types than expected raise."""


def read_definition(path: Path) -> tuple[Combination, ...]:
    """Read a table of combinations (.csv, .json), or a Simplex definition (.json)."""
    if path.suffix.lower() != ".json":
        rows = csv_rows(path, ("shape", "parts"))
    else:
        data = read_json(path, _LARGEST_BYTES)
        if isinstance(data, dict) and "progressions" in data:
            try:
                return _simplex(data, path)
            except _WRONG_TYPES as error:
                raise InputError(
                    f"{path}: is no Simplex definition: {type(error).__name__} {error}; export it "
                    "again, or state the combinations in a table"
                ) from error
        listed = data.get("combinations") if isinstance(data, dict) else data
        if not isinstance(listed, list):
            raise InputError(
                f"{path}: is neither a table of combinations (shape, parts, mode, weights) nor a "
                "Simplex definition; give one of these"
            )
        rows = [(f"combination {number}", row) for number, row in enumerate(listed, start=1)]
    return tuple(_combination(row, f"{path} {where}") for where, row in rows)


def _combination(row: Mapping[str, Any], where: str) -> Combination:
    """Return the combination of a row, whose lists are words in a CSV table."""

    def values(name: str) -> Iterable[Any]:
        listed = row.get(name) or ()
        return listed.split() if isinstance(listed, str) else listed

    try:
        pairs = [each.split("-") if isinstance(each, str) else each for each in values("spans")]
        return Combination(
            str(row.get("shape") or ""),
            tuple(map(str, values("parts"))),
            cast(CombinationMode, str(row.get("mode") or "product").strip()),
            tuple(map(float, values("weights"))),
            tuple((float(low), float(high)) for low, high in pairs),
        )
    except _WRONG_TYPES as error:
        raise InputError(
            f"{where}: is no combination: {error}; give its shape, its parts, and perhaps mode, "
            "weights and spans"
        ) from error


def _simplex(data: dict[str, Any], path: Path) -> tuple[Combination, ...]:
    """Read the combos of Simplex, encoding 1 to 3: sliders at 1 or -1 that drive a shape."""
    first = data.get("encodingVersion", 1) == 1
    shapes = [each if isinstance(each, str) else each["name"] for each in data["shapes"]]
    progressions = [
        list(zip(each[1], each[2], strict=True)) if first else each["pairs"]
        for each in data["progressions"]
    ]
    sliders = [each[1] if first else each["prog"] for each in data["sliders"]]

    def shape_at(progression: int, value: float, who: str) -> str:
        found = [shape for shape, at in progressions[progression] if at == value]
        if not found:
            raise InputError(f"{path}: {who} has no shape at {value:g}; state it in a table")
        return str(shapes[int(found[0])])

    for progression in progressions:
        for shape, at in progression:
            if abs(float(at)) not in (0.0, 1.0):
                raise InputError(
                    f"{path}: {shapes[int(shape)]} is at {float(at):g} of its progression, where "
                    "Simplex reduces the shape at 1, which combinations do not support; make it "
                    "an in-between of that shape, or state it in a table"
                )
    found = []
    for combo in data["combos"]:
        named = dict(zip(("name", "prog", "pairs"), combo, strict=False)) if first else combo
        if not named.get("enabled", True):  # 0 in Simplex
            continue
        name, pairs, solve = str(named["name"]), named["pairs"], str(named.get("solveType"))
        others = [value for _, value in pairs if abs(float(value)) != 1.0]
        if others:
            raise InputError(
                f"{path}: combo {name} has a slider at {others[0]:g}: Simplex interpolates such "
                "combos over triangles, which is not supported; state it in a table"
            )
        if solve not in _SIMPLEX_MODES or (
            len(pairs) > 2 and solve not in ("None", "min", "allMul")
        ):
            raise InputError(
                f"{path}: combo {name} of {len(pairs)} sliders has the solver {solve}, which is "
                "not supported (product, minimum and smooth are); state it in a table"
            )
        parts = tuple(
            shape_at(sliders[int(slider)], float(value), f"slider {slider} of {name}")
            for slider, value in pairs
        )
        driven = shape_at(int(named["prog"]), 1.0, f"combo {name}")
        found.append(Combination(driven, parts, _SIMPLEX_MODES[solve]))
    return tuple(found)


def merged(stated: Iterable[tuple[Combination, ...]]) -> tuple[Combination, ...]:
    """Return combinations of several sources, each once."""
    found = dict[str, Combination]()
    conflicts = []
    for each in (each for some in stated for each in some):
        if found.setdefault(each.shape, each) != each:
            conflicts.append(f"{found[each.shape]} and {each}")
    if conflicts:
        raise InputError(
            f"{pluralize(len(conflicts), 'combination')} stated in two ways: "
            f"{first_few(conflicts)}; give one source, or make them agree"
        )
    return tuple(found.values())
