"""Find what there is to publish and what it was made from, and check that it is fit for it."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.sidecars import LAYER_SUFFIXES, is_usd_name, weights_path
from usdface.model.review.verdict import SolveVerdict
from usdface.runner.origin import take_of_performance
from usdface.steps.edits.validate import check_layer
from usdface.steps.inputs.solve_verdict import judge_performance
from usdface.usdio.layers import read_provenance
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.take.read import is_take
from usdface.usdio.validation import Finding

MAKERS = ("map", "join", "retarget", "warp")
"""Steps that write performances."""


@dataclass(frozen=True)
class PublishItem:
    """A performance to publish."""

    name: str
    """What it is published as."""
    performance: Path
    """The layer that the animator opens."""
    take: Path | None
    """What it was mapped from; None where the layer does not say or the take is gone: then there is
    nothing to judge it by, and no sheet."""
    rig: Path
    """The character, which is published elsewhere and referenced."""
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Inclusive."""
    rate: Fraction
    """Frames per second."""
    timecode_start: str
    """SMPTE timecode of the first frame, empty when unknown."""
    shapes: int
    """Shapes that it drives."""
    edited: tuple[str, ...]
    """Shapes that an animator changed."""
    verdict: SolveVerdict | None = None
    """On the solve, without what was edited; None where nothing is known of its error."""


def collect_performances(paths: Iterable[Path]) -> tuple[PublishItem, ...]:
    """Return the performances among files and in folders.

    Parameters
    ----------
    paths : iterable of Path
        Performances, or folders with some: of a folder those count that usdface wrote.

    Raises
    ------
    InputError
        If a file named is no performance, or two would be published by one name.
    """
    found: dict[str, Path] = {}
    for path in paths:
        for file in _in_folder(path) if path.is_dir() else [path]:
            other = found.setdefault(file.stem, file)
            if other.resolve() != file.resolve():
                raise InputError(
                    f"{file}: has the name of {other}; publish them apart, or rename one"
                )
    return tuple(collect_performance(file) for file in found.values())


def collect_performance(path: Path) -> PublishItem:
    """Return one performance as an item to publish."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    reader = PerformanceReader(path)
    rig, _ = reader.rig()
    return PublishItem(
        name=path.stem,
        performance=path,
        take=_take_of(path),
        rig=rig,
        first_frame=reader.first_frame,
        last_frame=reader.last_frame,
        rate=reader.rate,
        timecode_start=reader.timecode_start,
        shapes=len(reader.names),
        edited=tuple(sorted(reader.edits)),
        verdict=judge_performance(reader),
    )


def _take_of(performance: Path) -> Path | None:
    """Return the take that a performance is of, if it is there to be shown beside it."""
    take = take_of_performance(performance)
    shown = take is not None and is_usd_name(take) and take.is_file() and is_take(take)
    return take if shown else None


def _in_folder(folder: Path) -> list[Path]:
    layers = sorted(path for path in folder.iterdir() if path.suffix.lower() in LAYER_SUFFIXES)
    return [path for path in layers if _is_performance(path)]


def _is_performance(path: Path) -> bool:
    try:
        made = read_provenance(path)
        if made is None or made.step not in MAKERS:
            return False
        # The layers beside it (weights, their parts and seams, controls) carry the same provenance
        # as the layer to open; none of them has a rig, and only the latter has weights beside it.
        return not path.stem.endswith(".weights") and weights_path(path).is_file()
    except InputError:
        return False


def validate_performance(item: PublishItem) -> tuple[Finding, ...]:
    """Return what is not in order in a performance, errors first; empty where nothing is.

    A verdict worse than Check is an error, or as `USDFACE_WORST_VERDICT` says.
    """
    found = check_layer(item.performance)
    if item.take is None:
        made = read_provenance(item.performance)
        again = (
            "retarget a take again (ingest a capture first)"
            if made is not None and made.step == "retarget"
            else "map it again"
        )
        found.append(
            Finding(
                "warning",
                "usdface:take",
                str(item.performance),
                "does not say which take it was made from, or that is gone: it is published "
                f"without a sheet to judge it by; {again} to have one",
            )
        )
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))
