"""Every file that a USD file needs beside it: what a farm without shared storage must carry."""

from pathlib import Path

from pxr import UsdUtils

from usdface.usdio.frame_span import check_span
from usdface.usdio.layers import (
    check_crates_below,
    open_layer,
    usd_errors_as_input_errors,
)


def referenced_files(path: Path) -> list[Path]:
    """Return a USD file, its layers, and the textures, movies and sounds that they name.

    Raises
    ------
    InputError
        If the file cannot be opened.
    """
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "finding what it refers to"):
        check_crates_below(layer)
        layers, assets, _ = UsdUtils.ComputeAllDependencies(layer.identifier)
    found = {Path(each.realPath) for each in layers if each.realPath}
    found |= {Path(asset) for asset in assets if Path(asset).is_file()}
    return sorted({path, *found})


def frame_range_of(path: Path) -> tuple[int, int] | None:
    """Return the first and last frame that a take or a performance says it has.

    Raises
    ------
    InputError
        If the file cannot be opened, or its range is none.
    """
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "reading its range"):
        if not (layer.HasStartTimeCode() and layer.HasEndTimeCode()):
            return None
        start, end = layer.startTimeCode, layer.endTimeCode
    check_span(f"{path}: startTimeCode to endTimeCode", start, end, samples=None)
    first, last = round(start), round(end)
    return (first, last) if last >= first else None
