"""What `usdface evaluate` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    Frames,
    Name,
    Positional,
    ReadPath,
    Reads,
    Spec,
)
from usdface.specs.measured import MeasuredOut

Limit = Annotated[float, Field(ge=0.0)]


class EvaluateSpec(Spec):
    """Measure a performance against what it should have been, or against another performance.

    Weights over the shapes that markers can show; the surface and the distance of the lips in mm;
    blinks at their peaks; jitter. For the whole face, by region and by shape. Beyond a limit the
    exit code is 1: a farm can stand guard over a publish.
    """

    example: ClassVar[str] = (
        "usdface evaluate kitchen.hero.usda --against animator.csv --out kitchen.error.json "
        "--max-vertex-rms 0.5"
    )

    step: Literal["evaluate"] = "evaluate"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to measure."""
    against: ReadPath
    """The truth, or another performance: .csv or .json (a `frame` column, then one per shape), or
    .usd with an animation."""
    out: MeasuredOut = ()
    """Where to write: .json for the figures, .png or .jpg for the curves; may be given twice."""
    frames: Frames | None = None
    """Measure these frames only, as FIRST-LAST."""
    unobservable: tuple[Name, ...] = ("eyeLook*",)
    """Shapes that markers cannot show, left out of the weights' error; * stands for anything."""
    max_weight_rmse: Limit | None = None
    """Most error of the weights."""
    max_vertex_rms: Limit | None = None
    """Most error of the surface, root mean square [mm]."""
    max_vertex_p95: Limit | None = None
    """Most error of the surface in 95 of 100 frames [mm]."""
    max_lip_error: Limit | None = None
    """Most error of the distance of the lips, root mean square [mm]."""
    max_blink_bias: Limit | None = None
    """Most that blinks may be off at their peaks, either way."""
    max_jitter: Limit | None = None
    """Most roughness; 1 is that of the truth."""
