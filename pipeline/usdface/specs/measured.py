"""Where a step that measures writes: figures, curves, or both."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

from usdface.specs.base import IMAGE_SUFFIXES, FilePath, Writes


def _one_or_several(given: Any) -> Any:
    return (given,) if isinstance(given, str | Path) else given


def _figures_or_curves(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    for path in paths:
        if path.suffix.lower() not in (".json", *IMAGE_SUFFIXES):
            raise ValueError(
                f"{path}: figures are written as .json, curves as {', '.join(IMAGE_SUFFIXES)}"
            )
    return paths


MeasuredOut = Annotated[
    tuple[FilePath, ...],
    BeforeValidator(_one_or_several),
    AfterValidator(_figures_or_curves),
    Writes(),
]
