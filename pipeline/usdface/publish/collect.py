"""Collection and validation of performances to publish."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.sidecars import LAYER_SUFFIXES, weights_path
from usdface.core.text import first_few
from usdface.model.review.verdict import SolveVerdict
from usdface.runner.origin import changed_inputs, existing_take
from usdface.steps.edits.validate import check_layer
from usdface.steps.inputs.solve_verdict import judge_performance
from usdface.usdio.layers import read_provenance
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.referenced_files import missing_sublayers
from usdface.usdio.validation import Finding

log = logging.getLogger(__name__)

PERFORMANCE_STEPS = ("map", "join", "retarget", "warp")
"""Steps that write performances."""


@dataclass(frozen=True)
class PublishItem:
    """A performance to publish."""

    name: str
    """Name of the publish."""
    performance: Path
    """The layer that the animator opens."""
    take: Path | None
    """The mapped take; None if unknown or missing: then there is no sheet."""
    rig: Path
    """The character, which is published separately and referenced."""
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: inclusive."""
    rate: Fraction
    """Frames per second."""
    timecode_start: str
    """SMPTE timecode of the first frame, empty if unknown."""
    edited: tuple[str, ...]
    """Shapes edited by an animator."""
    verdict: SolveVerdict | None = None
    """Of the solve without edits; None if its error is unknown."""


def collect_performances(paths: Iterable[Path]) -> tuple[PublishItem, ...]:
    """Return the performances among files and in folders.

    Parameters
    ----------
    paths : iterable of Path
        Performances, or folders of performances written by usdface.

    Raises
    ------
    InputError
        If a named file is not a performance, or two have the same name.
    """
    files: dict[str, Path] = {}
    for path in paths:
        for file in _in_folder(path) if path.is_dir() else [path]:
            other = files.setdefault(file.stem, file)
            if other.resolve() != file.resolve():
                raise InputError(
                    f"{file}: has the same name as {other}; publish them separately, or rename one"
                )
    return tuple(collect_performance(file) for file in files.values())


def collect_performance(path: Path) -> PublishItem:
    """Return one performance as an item to publish."""
    reader = PerformanceReader(path)
    rig, _ = reader.rig()
    return PublishItem(
        name=path.stem,
        performance=path,
        take=existing_take(path),
        rig=rig,
        first_frame=reader.first_frame,
        last_frame=reader.last_frame,
        rate=reader.rate,
        timecode_start=reader.timecode_start,
        edited=tuple(sorted(reader.edits)),
        verdict=judge_performance(reader),
    )


def _in_folder(folder: Path) -> list[Path]:
    layers = sorted(path for path in folder.iterdir() if path.suffix.lower() in LAYER_SUFFIXES)
    found = [path for path in layers if _is_performance(path)]
    if not found:
        log.warning("%s: holds no performances, nothing of it is published", folder)
    return found


def _is_performance(path: Path) -> bool:
    try:
        made = read_provenance(path)
        if made is None or made.step not in PERFORMANCE_STEPS:
            return False
        # Its other layers (weights, their parts and seams, controls) have the same provenance;
        # only the layer to open has a weights file of its name, or misses it.
        top = weights_path(path).is_file() or bool(missing_sublayers(path))
        return top and not path.stem.endswith(".weights")
    except InputError as error:
        log.warning("left out, as it cannot be read: %s", error)
        return False


def validate_performance(item: PublishItem) -> tuple[Finding, ...]:
    """Return the findings on a performance, errors first.

    A verdict worse than Check, or than `USDFACE_WORST_VERDICT`, is an error.
    """
    findings = check_layer(item.performance)
    if changed := changed_inputs(item.performance):
        findings.append(
            Finding(
                "warning",
                "usdface:inputs",
                str(item.performance),
                f"{first_few(each.name for each in changed)} changed since it was made: its "
                "weights and verdict are of what was there before; make it again",
            )
        )
    if item.take is None:
        made = read_provenance(item.performance)
        remedy = (
            "retarget a take again (ingest a capture first)"
            if made is not None and made.step == "retarget"
            else "map it again"
        )
        findings.append(
            Finding(
                "warning",
                "usdface:take",
                str(item.performance),
                "its take is unknown or missing, so it is published without a sheet; "
                f"{remedy} to have one",
            )
        )
    return tuple(sorted(findings, key=lambda finding: finding.severity != "error"))
