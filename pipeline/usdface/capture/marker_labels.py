"""From marker labels of capture systems to the unique marker names of a take."""

import difflib
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize

_UNLABELLED = re.compile(r"\*.*|u_?\d+|(?:unlabell?ed|unnamed|uname)[\W_]*\d*", re.IGNORECASE)
_SUGGESTION_COUNT = 5


@dataclass(frozen=True)
class MarkerLabels:
    """The labelled columns of a capture."""

    names: tuple[str, ...]
    """Unique, without subject prefixes."""
    columns: tuple[int, ...]
    """Column of each name."""
    notes: tuple[str, ...]
    """On columns left out and names changed."""


def resolve_labels(
    labels: Sequence[str], *, where: str, without: Collection[str] = ()
) -> MarkerLabels:
    """Remove subject prefixes, unlabelled points and labels `without`, and make names unique.

    `InputError` if two subjects have a marker of the same name, or if no point is labelled.
    """
    found: list[tuple[str, int]] = []
    dropped: list[str] = []
    subjects: dict[str, None] = {}
    for column, label in enumerate(labels):
        if label in without:
            continue
        prefix, _, name = label.strip().rpartition(":")
        if name and (_UNLABELLED.fullmatch(name) or _UNLABELLED.fullmatch(label.strip())):
            dropped.append(label)
            continue
        found.append((name, column))
        if name and prefix:
            subjects[prefix] = None
    if not found:
        raise InputError(
            f"{where}: no labelled marker among {len(labels)} ({first_few(dropped)}); "
            "label the markers in the capture software, then export again"
        )
    counts = Counter(name for name, _ in found if name)
    of_several = {
        name
        for name, whole in {(name, labels[column].strip()) for name, column in found}
        if counts[name] > 1 and whole != name
    }
    if len(subjects) > 1 and of_several:
        raise InputError(
            f"{where}: {pluralize(len(of_several), 'label')} given more than once "
            f"({first_few(sorted(of_several))}); the file holds the subjects "
            f"{first_few(subjects)}; export one subject alone"
        )
    used, names = set(counts), list[str]()
    empty, numbered = list[str](), list[str]()
    for name, column in found:
        if not name:
            name = _unused(f"marker_{column + 1}", used)
            empty.append(name)
        elif counts[name] > 1:
            name = _unused(f"{name}_1", used)
            numbered.append(name)
        names.append(name)
    notes = _notes(dropped, subjects, empty, numbered)
    return MarkerLabels(tuple(names), tuple(column for _, column in found), notes)


def _notes(
    dropped: list[str], subjects: Mapping[str, None], empty: list[str], numbered: list[str]
) -> tuple[str, ...]:
    notes = (
        (dropped, f"{len(dropped)} unlabelled markers were left out: {first_few(dropped)}"),
        (subjects, f"subject prefixes taken off: {first_few(subjects)}"),
        (
            empty,
            f"{pluralize(len(empty), 'marker')} with an empty label, named by column: "
            f"{first_few(empty)}",
        ),
        (
            numbered,
            f"{len(numbered)} markers share their labels with others and were numbered in the "
            f"file's order: {first_few(numbered)}; check which is which",
        ),
    )
    return tuple(note for names, note in notes if names)


def _unused(name: str, used: set[str]) -> str:
    """Increase the number at the end of `name` until it is unused; add the result to `used`."""
    stem, _, number = name.rpartition("_")
    count = int(number)
    while f"{stem}_{count}" in used:
        count += 1
    used.add(f"{stem}_{count}")
    return f"{stem}_{count}"


def match_labels(wanted: Sequence[str], names: Sequence[str], *, where: str) -> tuple[str, ...]:
    """Return the take's names of `wanted`, which may have a subject's prefix."""
    known = set(names)
    found = tuple(name if name in known else name.rpartition(":")[2] for name in wanted)
    missing = [name for name in found if name not in known]
    if missing:
        near = difflib.get_close_matches(missing[0], names, n=_SUGGESTION_COUNT) or list(names)
        raise InputError(
            f"{where}: rigid marker {first_few(missing)} not among the {len(names)} markers; "
            f"did you mean {first_few(near)}?"
        )
    return tuple(dict.fromkeys(found))
