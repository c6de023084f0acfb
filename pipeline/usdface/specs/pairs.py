"""What `usdface pairs propose` and `usdface pairs import` are told."""

from typing import Annotated, ClassVar, Literal

from usdface.specs.base import (
    FilePath,
    LayerOut,
    Name,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)


class PairsProposeSpec(Spec):
    """Propose pairs of expressions that mean the same on two characters.

    Shapes are matched by name (ARKit, ICT, FACS action units and their usual spellings), the
    others by what they do to the face. What people keyed stays; pairs that are there keep their
    time codes.
    """

    example: ClassVar[str] = (
        "usdface pairs propose --source human.usd --target dog.usd --out human_dog.pairs.usda"
    )

    step: Literal["pairs-propose"] = "pairs-propose"
    source: ReadPath
    """The character whose performances will be retargeted."""
    target: ReadPath
    """The character that shall act them."""
    out: LayerOut
    """The pairs asset: pair i at time code i."""
    match: Literal["both", "name", "deformation"] = "both"
    """By name, by what shapes do, or first the one and then the other."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target to key beside shapes, as PRIM.ATTRIBUTE from its top prim; *
    stands for anything."""
    joints: bool = True
    """Key the target's joints, where it has more than one."""
    source_prim: PrimPath | None = None
    """The face in the source's file, where it holds several."""
    target_prim: PrimPath | None = None
    """The face in the target's file, where it holds several."""


class PairsImportSpec(Spec):
    """Make pairs of two animations: what both hold at frame i is pair i.

    The source's is weights alone; the target's weights, joints and the attributes named.
    """

    example: ClassVar[str] = (
        "usdface pairs import --source human_poses.usd --target dog_poses.usd "
        "--source-rig human.usd --target-rig dog.usd --attributes 'rig/deformers.*' "
        "--out human_dog.pairs.usda"
    )

    step: Literal["pairs-import"] = "pairs-import"
    source: ReadPath
    """Source expressions: .usd with an animation, or .csv or .json (a `frame` column, then one per
    shape)."""
    target: ReadPath
    """Target expressions: .usd with an animation, or .csv or .json of weights."""
    source_rig: ReadPath
    """The source's character."""
    target_rig: Annotated[FilePath, Reads()]
    """The target's character."""
    out: LayerOut
    """The pairs asset to write."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target, as PRIM.ATTRIBUTE from its top prim; * stands for
    anything."""
    source_prim: PrimPath | None = None
    """The face in the source's file, where it holds several."""
    target_prim: PrimPath | None = None
    """The face in the target's file, where it holds several."""
