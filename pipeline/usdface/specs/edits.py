"""Specs of edits and publishing: edit, edits-import, bake, package."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.core.sidecars import edits_path
from usdface.specs.base import MovedRigSpec, Name, OnlyWith, Positional, Spec, WeightTableSpec
from usdface.specs.paths import (
    FilePath,
    Frames,
    LayerOut,
    PrimPath,
    ReadPath,
    Reads,
    WritePath,
    file_ending,
)

_Change = Annotated[float, Field(ge=-10.0, le=10.0)]


class _EditedSpec(MovedRigSpec):
    """Options common to `edit` and `edits import`."""

    makes = "edits"

    performance: Annotated[FilePath, Reads(alone=True), Positional()]
    """The performance to edit."""
    prim: PrimPath | None = None
    """Face to edit, if the layer holds several: its prim, or an ancestor of that face only."""

    def outputs(self) -> tuple[Path, ...]:
        """Return the layer that holds the edits."""
        return (edits_path(self.performance),)


class EditSpec(_EditedSpec):
    """Change shapes of a performance over a range of frames, without changing the solve.

    `--add` offsets the solve and follows it when it changes; `--override` replaces it. `--notes`
    applies the corrections noted in a report. A later edit takes precedence where it has full
    strength and blends in its fades. Edits are stored in NAME.edits.usda next to the performance,
    above its weights; mapping again keeps them.
    """

    example = "usdface edit kitchen.hero.usda --shape jawOpen --add 0.1 --frames 120-160 --fade 8"
    module = "edits.edit"

    step: Literal["edit"] = "edit"
    shape: tuple[Name, ...] = ()
    """Names of the shapes to change."""
    add: _Change | None = None
    """Weight to add to the solve."""
    override: _Change | None = None
    """Weight to use instead of the solve."""
    clear: bool = False
    """Remove edits, so that the solve shows again."""
    notes: ReadPath | None = None
    """Notes saved by a report, whose open corrections are applied. Those noted on another version
    of the performance are listed instead, so that none is applied twice."""
    frames: Frames | None = None
    """Frames to change, as FIRST-LAST. Default: all."""
    fade: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Length of the ease-in before the range and of the ease-out after it, in frames."""

    @model_validator(mode="after")
    def _one_change(self) -> Self:
        given = [self.add is not None, self.override is not None, self.clear]
        if self.notes is not None:
            if any(given) or self.shape or self.frames or self.fade:
                raise ValueError(
                    "--notes holds shapes, changes and frames; leave out the other options"
                )
            return self
        if not self.shape:
            raise ValueError("give the shapes to change by --shape, or --notes")
        if sum(given) != 1:
            raise ValueError("give one of --add, --override and --clear")
        if self.fade and self.frames is None:
            raise ValueError("a fade needs --frames; give them, or leave out --fade")
        return self


class EditsImportSpec(_EditedSpec, WeightTableSpec):
    """Import an animation changed in another tool as edits: its difference from the solve.

    Shapes are matched by name and frames by number. At the frames in the file the performance then
    equals the file; elsewhere edits do not change.
    """

    example = "usdface edits import kitchen.hero.usda --changed kitchen.animator.usd"
    module = "edits.import_"

    step: Literal["edits-import"] = "edits-import"
    changed: ReadPath
    """.usd with an animation, or .csv or .json (a `frame` column, then one column per shape)."""


class BakeSpec(MovedRigSpec):
    """Compose solve and edits into one layer of weights to publish.

    The layer holds the animation and the overs that bind the rig's skeletons to it. Any tool that
    reads UsdSkel plays it, without knowing about edits. The performance and its edits do not
    change.
    """

    example = "usdface bake kitchen.hero.usda --out kitchen.hero.published.usdc"
    module = "edits.bake"
    only_with: ClassVar[OnlyWith] = {"unit": ("tolerance", ())}

    step: Literal["bake"] = "bake"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance, with or without edits."""
    out: LayerOut
    """The layer to write."""
    tolerance: Annotated[float, Field(gt=0.0)] | None = None
    """Largest deviation of linear interpolation between the remaining keys, in --unit. Default: all
    frames are keyed."""
    unit: Literal["weight", "mm"] = "weight"
    """Unit of the tolerance: `weight`, or `mm` of displacement of the face's surface."""
    limit: bool = False
    """Clamp edited weights to the rig's ranges. Solved weights always lie within them."""
    prim: PrimPath | None = None
    """Face to bake, if the layer holds several: its prim, or an ancestor of that face only."""


class CombineSpec(Spec):
    """Combine several takes of one character in one asset, a variant per take.

    The variant set `take` on the character's prim selects the performance. Each variant references
    its performance and follows its later changes. The performances must have the same rig, prim
    path and rate.
    """

    example = "usdface combine kitchen.hero.usda stairs.hero.usda --out hero.takes.usda"
    module = "edits.combine"

    step: Literal["combine"] = "combine"
    performances: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(), Positional()]
    """The performances, with or without edits."""
    out: LayerOut
    """The asset to write."""
    takes: tuple[Name, ...] = ()
    """Names of the variants, one per performance; the first is selected. Default: the files' names
    without their common parts."""


class PackageSpec(MovedRigSpec):
    """Pack rig, textures and edited weights of a performance into one .usdz for review.

    The package has no external dependencies and opens in any USD viewer. It is a copy for review;
    publish the layers (`usdface bake`).
    """

    example = "usdface package kitchen.hero.usda --out kitchen.review.usdz"
    module = "edits.package"

    step: Literal["package"] = "package"
    performance: Annotated[FilePath, Reads(assets=True), Positional()]
    """The performance, with or without edits."""
    out: Annotated[WritePath, AfterValidator(file_ending((".usdz",), "a package"))]
    """The package to write."""
    prim: PrimPath | None = None
    """Face to pack, if the layer holds several: its prim, or an ancestor of that face only."""
