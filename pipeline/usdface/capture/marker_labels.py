"""Marker labels as capture systems write them, reduced to the names a take keeps."""

import difflib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize

_UNLABELLED = re.compile(r"\*.*|u_?\d+|(?:unlabell?ed|unnamed|uname)[\W_]*\d*", re.IGNORECASE)
_SUGGESTION_COUNT = 5


@dataclass(frozen=True)
class MarkerLabels:
    """Which columns of a capture are markers."""

    names: tuple[str, ...]
    """Unique, subject prefixes taken off."""
    columns: tuple[int, ...]
    """Column of each name."""
    dropped: tuple[str, ...]
    """Labels of points that no one has labelled."""
    subjects: tuple[str, ...]
    """Prefixes that were taken off."""

    def notes(self) -> list[str]:
        """Say what was left out and taken off, if anything."""
        found = []
        if self.dropped:
            found.append(
                f"{len(self.dropped)} unlabelled markers were left out: {first_few(self.dropped)}"
            )
        if self.subjects:
            found.append(f"subject prefixes taken off: {first_few(self.subjects)}")
        return found


def settle_labels(labels: Sequence[str], *, where: str) -> MarkerLabels:
    """Take subject prefixes off and leave unlabelled points out.

    Raises
    ------
    InputError
        If a label is empty or appears twice, or if none is left.
    """
    names: list[str] = []
    columns: list[int] = []
    dropped: list[str] = []
    subjects: dict[str, None] = {}
    empty: list[int] = []
    for column, label in enumerate(labels):
        prefix, _, name = label.strip().rpartition(":")
        if not name:
            empty.append(column + 1)
        elif _UNLABELLED.fullmatch(name) or _UNLABELLED.fullmatch(label.strip()):
            dropped.append(label)
        else:
            names.append(name)
            columns.append(column)
            if prefix:
                subjects[prefix] = None
    doubled = [name for name, count in Counter(names).items() if count > 1]
    faults = []
    if empty:
        faults.append(f"{pluralize(len(empty), 'marker')} with an empty label ({first_few(empty)})")
    if doubled:
        faults.append(
            f"{pluralize(len(doubled), 'label')} given more than once ({first_few(doubled)})"
        )
    if faults:
        several = (
            f"; the file holds the subjects {first_few(subjects)}" if len(subjects) > 1 else ""
        )
        raise InputError(
            f"{where}: {' and '.join(faults)}{several}; give every marker its own label in the "
            "capture software, or export one subject alone"
        )
    if not names:
        raise InputError(
            f"{where}: no labelled marker among {len(labels)} ({first_few(dropped)}); "
            "label the markers in the capture software, then export again"
        )
    return MarkerLabels(tuple(names), tuple(columns), tuple(dropped), tuple(subjects))


def match_labels(
    wanted: Sequence[str], names: Sequence[str], *, where: str, role: str
) -> tuple[str, ...]:
    """Return `wanted` as the take names them, with or without the subject's prefix.

    Raises
    ------
    InputError
        If a name is not a marker of the take, with the nearest ones.
    """
    known = set(names)
    found = tuple(name if name in known else name.rpartition(":")[2] for name in wanted)
    missing = [name for name in found if name not in known]
    if missing:
        near = difflib.get_close_matches(missing[0], names, n=_SUGGESTION_COUNT) or list(names)
        raise InputError(
            f"{where}: {role} {first_few(missing)} not among the {len(names)} markers; "
            f"did you mean {first_few(near)}?"
        )
    return tuple(dict.fromkeys(found))
