"""Specs of retargeting: pairs, train-retarget, retarget, cyclic, sequences, warp."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.core.sidecars import proposed_path, weights_path
from usdface.specs.base import Drive, Name, NeverWith, OnlyWith, Positional, Spec, WeightTableSpec
from usdface.specs.paths import (
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    MeasuredOut,
    PrimPath,
    ReadPath,
    Reads,
    Several,
)


class PairsProposeSpec(Spec):
    """Propose pairs of corresponding expressions of two characters.

    Shapes are matched by the meaning of their names (`usdface names` shows the pairs), the others
    by how they deform the face. Keyed and imported pairs are kept at their time codes, and
    proposals of earlier runs replaced.
    """

    example = "usdface pairs propose --source human.usd --target dog.usd --out human_dog.pairs.usda"
    module = "retarget.pairs_propose"
    makes = "pairs"
    sidecars = (proposed_path,)
    never_with: ClassVar[NeverWith] = {"match": ("names",)}

    step: Literal["pairs-propose"] = "pairs-propose"
    source: ReadPath
    """Rig whose performances will be retargeted; or, without a rig, a take, capture or table of
    weights, which is matched by name only."""
    target: ReadPath
    """Rig to drive."""
    out: LayerOut
    """The pairs asset to write: pair i at time code i."""
    match: Literal["both", "name", "deformation"] = "both"
    """Match by `name`, by `deformation`, or by name first and then by deformation (`both`)."""
    names: ReadPath | None = None
    """Table of pairs of shapes to use instead, as `usdface names` writes it (.csv or .json)."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target to key with the shapes, as PRIM.ATTRIBUTE from its top prim. *
    matches any characters."""
    joints: bool = True
    """Key the target's joints, if it has more than one."""
    source_prim: PrimPath | None = None
    """Face in the source's file, if it holds several."""
    target_prim: PrimPath | None = None
    """Face in the target's file, if it holds several."""


class PairsImportSpec(WeightTableSpec):
    """Make pairs from two animations: pair i holds both at frame i.

    The source animation provides weights; the target animation provides weights, joints and the
    named attributes.
    """

    example = (
        "usdface pairs import --source human_poses.usd --target dog_poses.usd "
        "--source-rig human.usd --target-rig dog.usd --attributes 'rig/deformers.*' "
        "--out human_dog.pairs.usda"
    )
    module = "retarget.pairs_import"
    makes = "pairs"
    sidecars = (proposed_path,)

    step: Literal["pairs-import"] = "pairs-import"
    source: ReadPath
    """Source expressions: .usd with an animation, or .csv or .json (a `frame` column, then one
    column per shape)."""
    target: ReadPath
    """Target expressions: .usd with an animation, or .csv or .json of weights."""
    source_rig: ReadPath
    """Rig of the source."""
    target_rig: Annotated[FilePath, Reads()]
    """Rig of the target."""
    out: LayerOut
    """The pairs asset to write."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target, as PRIM.ATTRIBUTE from its top prim. * matches any
    characters."""
    source_prim: PrimPath | None = None
    """Face in the source's file, if it holds several."""
    target_prim: PrimPath | None = None
    """Face in the target's file, if it holds several."""


class TrainRetargetSpec(Spec):
    """Train the mapping from a source's weights to a target's controls.

    `auto` maps expressions to the target and back by every method and keeps the one with the
    smallest round-trip error. The table of scores is stored (`usdface describe`).
    """

    example = "usdface train-retarget human_dog.pairs.usda --out human_dog.retarget.usdc"
    module = "retarget.train"
    cores = 2
    memory_mib = 8192

    only_with: ClassVar[OnlyWith] = {
        "alpha": ("method", ("hybrid",)),
        "published": ("method", ("kernel_cca", "hybrid")),
    }

    step: Literal["train-retarget"] = "train-retarget"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    out: LayerOut
    """The retargeting to write."""
    references: ReadPath | None = None
    """References of takes that carry weights, from `usdface select`, whose tuned pairs are
    added."""
    method: Name = "auto"
    """Regression method: `auto`, `rbf`, `kernel_cca`, `hybrid`, `additive` or `ridge`."""
    source: ReadPath | None = None
    """Performance of the source on which methods are compared. Default: mixtures of the pairs."""
    alpha: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    """Share of the multiquadric in `hybrid`, 0 to 1. Default: chosen with the method. `retarget
    --alpha` varies it over time."""
    published: bool = False
    """With `kernel_cca` or `hybrid`: the regression between the reduced expressions is plain least
    squares over few components, as published. By default it uses all components, with the same
    penalty as these."""


class RetargetSpec(WeightTableSpec):
    """Transfer weights to one or more characters.

    With --retargeting, a mapping trained on pairs is used: give it and --out once per target.
    Without it, weights are transferred to the rigs of --rig by the meaning of the shapes' names:
    Live Link, MetaHuman, Character Creator, FACS and others (`usdface names` shows the pairs). Each
    target gets a performance of its rig, which is referenced and does not change. Given a folder,
    with a folder as --out, every take or capture in it is retargeted.

    With --source-rig and --rig, the positions of the two surfaces are matched by non-negative least
    squares, without pairs or names: the baseline of Song et al. 2011, figure 2.
    """

    example = "usdface retarget kitchen.csv --rig hero.usd --out kitchen.hero.usda"
    module = "retarget.retarget"
    makes = "performance"
    sidecars = (weights_path,)
    only_with: ClassVar[OnlyWith] = {"alpha": ("retargeting", ())}
    never_with: ClassVar[NeverWith] = {"source_rig": ("retargeting",)}

    step: Literal["retarget"] = "retarget"
    source: Annotated[FilePath, Reads(), Positional()]
    """Source weights: a take that carries them, a performance, or a capture file or table of
    weights, such as the CSV of Live Link Face."""
    retargeting: Annotated[tuple[FilePath, ...], Reads(), Several] = ()
    """Files written by `usdface train-retarget`, one per target."""
    out: Annotated[tuple[LayerOut, ...], Field(min_length=1), Several]
    """The performances to write, one per target."""
    rig: Annotated[tuple[FilePath, ...], Reads(), Several] = ()
    """Rigs of the targets; with --retargeting, only if they have moved since training."""
    names: ReadPath | None = None
    """Table of pairs of shapes to use instead of the names' meaning, as `usdface names` writes it
    (.csv or .json)."""
    source_rig: ReadPath | None = None
    """Rig of the source: match positions of its surface instead, the baseline of the paper."""
    prim: PrimPath | None = None
    """Prim path of the rig in its performance. Default: the name of the rig's default prim."""
    drive: Drive = ()
    """Joint or Xform of the rig that the source's head motion or gaze drives, as PART=NAME, where
    PART is `head`, `left_eye` or `right_eye`. May be given once per part. Written to
    NAME.head.usdc, above the weights."""
    alpha: ReadPath | None = None
    """Share of the multiquadric in a `hybrid` retargeting over time: .csv (frame, alpha), or .usd
    with a time-sampled float `face:mapping:alpha` on any prim."""
    frames: Frames | None = None
    """Frames to retarget, as FIRST-LAST. Default: all."""
    rate: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Frames per second of a table of weights that has no column of times. Recordings of phones:
    59.94 is accepted where the clock counts to 60."""
    shapes: ReadPath | None = None
    """Names of the columns of a .npy matrix of weights, as for `ingest`."""
    take: Name | None = None
    """Take to read from a table that holds several."""

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if not self.retargeting and not self.rig:
            raise ValueError(
                "no target is given: name its rig with --rig, or the output of `usdface "
                "train-retarget` with --retargeting"
            )
        trained = len(self.retargeting) or len(self.out)
        if len(self.out) != trained or len(self.rig) not in (0, len(self.out)):
            raise ValueError(
                f"{len(self.retargeting)} retargetings, {len(self.out)} outputs and "
                f"{len(self.rig)} rigs; give one of each per target; either the rigs or the "
                "retargetings may be left out"
            )
        return self


METHODS = ("auto", "rbf", "kernel_cca", "hybrid", "additive", "ridge", "positions")


class CyclicSpec(WeightTableSpec):
    """Measure the round-trip error of retargeting, source to target to source, in mm per frame.

    No keys of the target are needed. Every method is trained on the pairs in both directions;
    `positions` matches surface positions by non-negative least squares and needs no pairs.
    """

    example = (
        "usdface cyclic human_dog.pairs.usda --source kitchen.take.usda "
        "--out kitchen.cyclic.json --out kitchen.cyclic.jpg"
    )
    module = "retarget.cyclic"

    only_with: ClassVar[OnlyWith] = {"weight_unit": ("truth", ())}

    step: Literal["cyclic"] = "cyclic"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    source: ReadPath
    """Source weights: a take that carries them (Live Link), or a performance."""
    out: MeasuredOut = ()
    """Files to write: .json for figures, .png or .jpg for curves. May be given twice."""
    methods: Annotated[tuple[Name, ...], Field(min_length=1)] = METHODS
    """Methods to compare."""
    published: bool = False
    """Compare `kernel_cca` and `hybrid` as published; see `train-retarget --published`."""
    alpha: ReadPath | None = None
    """Share of the multiquadric over time, measured as `hybrid, keyed` (figure 5 of the paper):
    .csv (frame, alpha), or .usd with a time-sampled float `face:mapping:alpha` on any prim."""
    truth: ReadPath | None = None
    """Known weights of the target (.usd, .csv or .json), to measure the direct error as well."""
    frames: Frames | None = None
    """Frames to measure, as FIRST-LAST. Default: all."""
    every: Annotated[int, Field(ge=1, le=10**9)] = 1
    """Measure every n-th frame."""

    @model_validator(mode="after")
    def _published_is_of_kernel_cca(self) -> Self:
        measured = {"auto", "kernel_cca", "hybrid"} & set(self.methods)
        if self.published and not measured and self.alpha is None:
            raise ValueError(
                f"published has no effect with methods {', '.join(self.methods)}; leave it out, or "
                "give methods kernel_cca or hybrid, or alpha"
            )
        return self


class MakeSequenceSpec(Spec):
    """Pair a range of a source's motion with the target animation that replaces it.

    The two may differ in length and timing.
    """

    example = (
        "usdface make-sequence --source surprise.take.usda --source-frames 120-190 "
        "--target dog_surprise.usda --label surprise --out surprise.sequence.usda"
    )
    module = "retarget.make_sequence"

    step: Literal["make-sequence"] = "make-sequence"
    source: ReadPath
    """A take with source weights, or a performance of the source."""
    target: ReadPath
    """Animation of the target, keyed by an animator."""
    out: LayerOut
    """The sequence to write."""
    label: Name
    """Emotion of the sequence."""
    source_frames: Frames | None = None
    """Frames of the source, as FIRST-LAST. Default: all."""
    target_frames: Frames | None = None
    """Frames of the target, as FIRST-LAST. Default: all."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target in the sequence, as PRIM.ATTRIBUTE from its top prim. *
    matches any characters. Default: all that move."""


class FindSequencesSpec(Spec):
    """Find the frames of a source performance that match emotional sequences.

    With `similarity`, the default, a range matches if its distance to the sequence is less than
    half the distance of the best constant expression; there is no threshold to set. Review the
    result before warping: deactivate matches, or move them.
    """

    example = (
        "usdface find-sequences kitchen.take.usda --sequence surprise.sequence.usda "
        "--out kitchen.matches.usda"
    )
    module = "retarget.find_sequences"
    only_with: ClassVar[OnlyWith] = {"threshold": ("by", ("threshold", "published"))}

    step: Literal["find-sequences"] = "find-sequences"
    source: Annotated[FilePath, Reads(), Positional()]
    """A take with source weights, or a performance of the source."""
    sequence: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads(), Several]
    """Sequence to search for. May be given several times."""
    out: LayerOut
    """The list of matches to write."""
    by: Literal["similarity", "threshold", "published", "label"] = "similarity"
    """`similarity`; `threshold`, a limit of the mean difference; `published`, a limit of the sum of
    differences, which depends on the length and the number of shapes (Song et al. 2011, eq. 10); or
    `label`, the nearest range for each sequence with the take's emotion, at any distance."""
    threshold: Annotated[float, Field(gt=0.0)] | None = None
    """With --by threshold: largest mean difference of the weights, independent of the sequence's
    length and number of shapes. With --by published: the paper's delta. Default there: its 1.0."""
    label: Name | None = None
    """Search only for sequences of this emotion; with --by label, instead of the take's."""
    shapes: tuple[Name, ...] = ()
    """Source shapes to compare. Default: all. * matches any characters. Combination shapes and
    angles are never compared."""
    frames: Frames | None = None
    """Frames to search, as FIRST-LAST. Default: all."""

    @model_validator(mode="after")
    def _threshold_is_given(self) -> Self:
        if self.by == "threshold" and self.threshold is None:
            raise ValueError("--by threshold needs --threshold")
        return self


class WarpSpec(Spec):
    """Blend keyed sequences of a target into its retargeted performance.

    All controls are warped: weights, joints and attributes. Outside the sequences and their blends
    the performance stays the same, bit for bit.
    """

    example = (
        "usdface warp kitchen.dog.usda --matches kitchen.matches.usda "
        "--out kitchen.warped.usda --curves kitchen.warp.jpg"
    )
    module = "retarget.warp"
    sidecars = (weights_path,)

    step: Literal["warp"] = "warp"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The target's performance."""
    matches: ReadPath
    """Matches written by `usdface find-sequences`."""
    out: LayerOut
    """The performance to write."""
    weight: Annotated[float, Field(gt=0.0, le=1e9)] = 20.0
    """Weight of the sequences' keys relative to the performance. At 1, as published, fast motion is
    the mean of both; at 1000 it is that of the sequence."""
    blend: Annotated[int, Field(ge=0, le=10_000)] = 12
    """Frames on each side over which the performance blends into a sequence; the weight of the
    sequence's first and last keys ramps over the same number of frames. 0 for neither, as
    published."""
    timing: Literal["own", "fit"] = "own"
    """`own` keeps the length of a sequence, from the start of the match; `fit` stretches it to the
    match."""
    outside: Literal["exact", "published"] = "exact"
    """`exact` preserves frames outside bit for bit; `published` uses soft constraints of weight 1:
    with --weight 1 and --blend 0, eq. 12 of the paper."""
    curves: ImageOut | None = None
    """Picture to write of the controls that change most, before and after."""
