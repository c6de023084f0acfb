"""Specs of retargeting: pairs, train-retarget, retarget, cyclic, sequences, warp."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from usdface.specs.base import (
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)
from usdface.specs.paths import MeasuredOut


class PairsProposeSpec(Spec):
    """Propose pairs of expressions that mean the same on two characters.

    Shapes are matched by name (ARKit, ICT, FACS action units and their usual spellings), the
    others by what they do to the face. What people keyed stays; pairs that are there keep their
    time codes.
    """

    example: ClassVar[str] = (
        "usdface pairs propose --source human.usd --target dog.usd --out human_dog.pairs.usda"
    )
    module: ClassVar[str] = "retarget.pairs_propose"

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
    module: ClassVar[str] = "retarget.pairs_import"

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


class TrainRetargetSpec(Spec):
    """Learn from expression pairs how a source's weights drive a target.

    `auto` sends expressions to the target and back by every method and keeps the one that returns
    them best; the table of what was tried is kept (`usdface describe`).
    """

    example: ClassVar[str] = (
        "usdface train-retarget human_dog.pairs.usda --out human_dog.retarget.usdc"
    )
    module: ClassVar[str] = "retarget.train"

    step: Literal["train-retarget"] = "train-retarget"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    out: LayerOut
    """The retargeting to write."""
    method: Name = "auto"
    """auto, rbf, kernel_cca, hybrid, additive or ridge."""
    source: ReadPath | None = None
    """A performance of the source: methods are compared on it rather than on mixtures of pairs."""
    alpha: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    """Share of the multiquadric in the hybrid; chosen with the method by default. `retarget` takes
    one that is keyed over time."""


class RetargetSpec(Spec):
    """Let one performance drive any number of other characters.

    Each gets a performance of its own: weights, joints and attributes alike, over its rig, which is
    referenced and never written. --retargeting and --out are given once for each target.
    """

    example: ClassVar[str] = (
        "usdface retarget kitchen.take.usda --retargeting human_dog.retarget.usdc "
        "--out kitchen.dog.usda"
    )
    module: ClassVar[str] = "retarget.retarget"

    step: Literal["retarget"] = "retarget"
    source: Annotated[FilePath, Reads(), Positional()]
    """Source weights: a take that carries them (Live Link), or a performance."""
    retargeting: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads()]
    """What `usdface train-retarget` wrote, one for each target."""
    out: Annotated[tuple[LayerOut, ...], Field(min_length=1)]
    """The performances to open, one for each target."""
    rig: Annotated[tuple[FilePath, ...], Reads()] = ()
    """The targets, where they are no longer where they were at training."""
    prim: PrimPath | None = None
    """Where the rig is put in its performance; its own default prim's name by default."""
    alpha: ReadPath | None = None
    """Share of the multiquadric in a hybrid over time: .csv (frame, alpha), or .usd with a
    time-sampled float `face:mapping:alpha` on any prim."""
    frames: Frames | None = None
    """Retarget these frames only, as FIRST-LAST."""

    @field_validator("retargeting", "out", "rig", mode="before")
    @classmethod
    def _one_or_several(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str | Path) else given

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if len(self.out) != len(self.retargeting) or len(self.rig) not in (0, len(self.out)):
            raise ValueError(
                f"{len(self.retargeting)} retargetings, {len(self.out)} outputs and "
                f"{len(self.rig)} rigs; give one of each for every target, or no rig at all"
            )
        return self


METHODS = ("auto", "rbf", "kernel_cca", "hybrid", "ridge", "positions")


class CyclicSpec(Spec):
    """Measure retargeting without knowing the truth: source to target and back, in mm per frame.

    Every method is trained on the pairs in both directions; `positions` matches positions of the
    two surfaces by non-negative least squares and needs no pairs.
    """

    example: ClassVar[str] = (
        "usdface cyclic human_dog.pairs.usda --source kitchen.take.usda "
        "--out kitchen.cyclic.json --out kitchen.cyclic.jpg"
    )
    module: ClassVar[str] = "retarget.cyclic"

    step: Literal["cyclic"] = "cyclic"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    source: ReadPath
    """Source weights: a take that carries them (Live Link), or a performance."""
    out: MeasuredOut = ()
    """Where to write: .json for the figures, .png or .jpg for the curves; may be given twice."""
    methods: tuple[Name, ...] = METHODS
    """What to compare."""
    truth: ReadPath | None = None
    """What the target should do, where it is known: weights as .usd, .csv or .json; then the direct
    error is measured as well."""
    frames: Frames | None = None
    """Measure these frames only, as FIRST-LAST."""
    every: Annotated[int, Field(ge=1)] = 1
    """Measure every n-th frame."""


class MakeSequenceSpec(Spec):
    """Tie a stretch of a source's motion to what the target does in its place.

    The two may differ in length and timing; only what they mean must be the same.
    """

    example: ClassVar[str] = (
        "usdface make-sequence --source surprise.take.usda --source-frames 120-190 "
        "--target dog_surprise.usda --label surprise --out surprise.sequence.usda"
    )
    module: ClassVar[str] = "retarget.make_sequence"

    step: Literal["make-sequence"] = "make-sequence"
    source: ReadPath
    """A take with source weights, or a performance of the source."""
    target: ReadPath
    """An animation of the target, as an animator made it."""
    out: LayerOut
    """The sequence to write."""
    label: Name
    """The emotion."""
    source_frames: Frames | None = None
    """The stretch of the source, as FIRST-LAST; all of it by default."""
    target_frames: Frames | None = None
    """The stretch of the target, as FIRST-LAST; all of it by default."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target that the sequence holds, as PRIM.ATTRIBUTE."""


class FindSequencesSpec(Spec):
    """Find where a source performance holds emotional sequences.

    By similarity (the default), a place counts when it is nearer than half of what the best face
    held still would reach; no threshold to tune. The result is a list to look through: deactivate
    a match, or move it, before warping.
    """

    example: ClassVar[str] = (
        "usdface find-sequences kitchen.take.usda --sequence surprise.sequence.usda "
        "--out kitchen.matches.usda"
    )
    module: ClassVar[str] = "retarget.find_sequences"

    step: Literal["find-sequences"] = "find-sequences"
    source: Annotated[FilePath, Reads(), Positional()]
    """A take with source weights, or a performance of the source."""
    sequence: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads()]
    """A sequence to look for; may be given several times."""
    out: LayerOut
    """The list of places to write."""
    by: Literal["similarity", "threshold", "label"] = "similarity"
    """similarity; threshold, as published; or label: the nearest place of each sequence whose
    emotion is the take's, however near, for the label vouches that it is there."""
    threshold: Annotated[float, Field(gt=0.0)] | None = None
    """Mean difference that is allowed, in weights, whatever the sequence's length and channels."""
    label: Name | None = None
    """Look only for sequences of this emotion; with --by label, instead of the take's own."""
    shapes: tuple[Name, ...] = ()
    """Compare these source shapes only; * stands for anything."""
    frames: Frames | None = None
    """Look in these frames only, as FIRST-LAST."""

    @field_validator("sequence", mode="before")
    @classmethod
    def _one_or_several(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str | Path) else given

    @model_validator(mode="after")
    def _threshold_where_it_counts(self) -> Self:
        if (self.by == "threshold") != (self.threshold is not None):
            raise ValueError("--by threshold and --threshold go together; give both or neither")
        return self


class WarpSpec(Spec):
    """Put a target's own sequences into its retargeted performance, smoothly.

    Every control is warped: weights, joints and attributes. Outside the sequences and their blends
    the performance stays as it was, to the last bit.
    """

    example: ClassVar[str] = (
        "usdface warp kitchen.dog.usda --matches kitchen.matches.usda "
        "--out kitchen.warped.usda --curves kitchen.warp.jpg"
    )
    module: ClassVar[str] = "retarget.warp"

    step: Literal["warp"] = "warp"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The target's performance."""
    matches: ReadPath
    """Where the take holds sequences: what `usdface find-sequences` wrote."""
    out: LayerOut
    """The performance to write."""
    weight: Annotated[float, Field(gt=0.0, le=1e9)] = 20.0
    """How firmly the sequences' keys are asked for. With 1, as published, quick changes are half
    the performance's own; with 1000 they are the sequence's alone."""
    blend: Annotated[int, Field(ge=0, le=10_000)] = 12
    """Frames on each side over which the performance passes into a sequence."""
    timing: Literal["own", "fit"] = "own"
    """Play a sequence as long as it was made, from where it was found; or stretch it to fit."""
    outside: Literal["exact", "published"] = "exact"
    """Keep what is outside to the last bit; or by soft constraints of weight 1, as published."""
    curves: ImageOut | None = None
    """Draw the controls that change most, before and after."""
