"""Retarget every take of a folder to the same characters."""

from dataclasses import replace
from pathlib import Path

from usdface.capture.sniff import recognise_format, visible_files
from usdface.capture.weight_table import read_weight_take
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.text import pluralize
from usdface.runner.execute import execute_each
from usdface.runner.result import StepResult
from usdface.specs.retarget import RetargetSpec

TAKE_SUFFIX = ".take.usda"

_OF_WEIGHTS = (
    *("live-link-csv", "face-cap", "ifacialmocap", "openface-csv"),
    *("weights-csv", "weights-json", "weights-npy"),
)
"""Formats whose captures carry weights."""

_OF_TABLES = ("rate", "weight_unit", "shapes", "take")
"""Options for the tables of a folder; takes and recorders' files state them."""


def retarget_folder(
    folder: Path,
    out: Path,
    shared: RetargetSpec,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StepResult:
    """Retarget every take and capture of a folder, to ``TAKE.RIG.usda`` in `out`.

    `shared` has the targets and options; its source and outputs are not used.
    """
    for name in ("frames", "alpha"):
        if getattr(shared, name):
            raise InputError(f"{folder}: --{name} is for a single take; leave it out for a folder")
    sources = _takes(folder)
    if not sources:
        raise InputError(
            f"{folder}: holds no take ({TAKE_SUFFIX}) and no capture with weights; name the folder "
            "that holds them"
        )
    targets = [path.name.partition(".")[0] for path in shared.rig or shared.retargeting]
    if len(set(targets)) < len(targets):
        raise InputError(
            f"{folder}: performances are named after their targets, and two of "
            f"{', '.join(targets)} are equal; retarget to one of them at a time"
        )
    tables = {
        source
        for source in sources.values()
        if not source.name.endswith(TAKE_SUFFIX)
        and recognise_format(source).read is read_weight_take
    }
    specs = [
        shared.model_copy(
            update=({} if source in tables or not tables else dict.fromkeys(_OF_TABLES))
            | {
                "source": source,
                "out": tuple(out / f"{stem}.{target}.usda" for target in targets),
            }
        )
        for stem, source in sources.items()
    ]
    result = execute_each(
        specs,
        folder=folder,
        out=out,
        done_as="retargeted",
        overwrite=overwrite,
        progress=progress,
    )
    return replace(result, summary=f"{result.summary} on {pluralize(len(targets), 'target')}")


def _takes(folder: Path) -> dict[str, Path]:
    """Return sources by stem; a take takes precedence over a capture of the same stem."""
    files = visible_files(folder)
    takes = [path for path in files if path.name.endswith(TAKE_SUFFIX)]
    found = {path.name.removesuffix(TAKE_SUFFIX): path for path in takes}
    for path in filter(_is_capture, files):
        found.setdefault(path.stem, path)
    return found


def _is_capture(path: Path) -> bool:
    try:
        return recognise_format(path).name in _OF_WEIGHTS
    except (InputError, OSError):
        return False
