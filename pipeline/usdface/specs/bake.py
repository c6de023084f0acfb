"""What `usdface bake` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, LayerOut, Positional, PrimPath, Reads, Spec


class BakeSpec(Spec):
    """Compose solve and edits into the weights that are published.

    Writes one layer with the animation and the overs that point the rig's skeletons at it: any
    tool that reads UsdSkel plays it, whether it knows of edits or not. The performance and its
    edits stay as they are.
    """

    example: ClassVar[str] = "usdface bake kitchen.hero.usda --out kitchen.hero.published.usdc"

    step: Literal["bake"] = "bake"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance, with or without edits."""
    out: LayerOut
    """The layer to publish."""
    tolerance: Annotated[float, Field(gt=0.0)] | None = None
    """Keep only the keys that lines between them need to stay this close; all frames by default."""
    unit: Literal["weight", "mm"] = "weight"
    """What the tolerance is measured in: weights, or how far the face's surface moves."""
    limit: bool = False
    """Keep edited weights within the rig's ranges; solved ones are."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""
