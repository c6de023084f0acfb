"""Specs of references: place, select, import, from-edits, add, coverage, sheet."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.core.sidecars import (
    coverage_path,
    placement_path,
    proposed_path,
    samples_path,
    tuned_path,
)
from usdface.specs.base import (
    MovedRigSpec,
    Name,
    NeverWith,
    OnlyWith,
    Positional,
    Spec,
    WeightTableSpec,
)
from usdface.specs.paths import (
    ChosenFrames,
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    PrimPath,
    ReadPath,
    Reads,
)

_Takes = Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]


class PlaceSpec(Spec):
    """Place a performer's markers on the surface of a rig, and draw them.

    A verdict states whether the placement is plausible. To correct a marker, drag it on the tuning
    page, move its ball in the corrected layer next to the placement, or give its position with
    --landmarks. Placing again keeps corrections and places the other markers by them.
    """

    example = (
        "usdface place kitchen.clean.take.usda --rig hero.usd --out hero.placement.usda "
        "--picture hero.placement.jpg"
    )
    module = "references.place"
    sidecars = (proposed_path,)
    cores = 2
    memory_mib = 4096
    only_with: ClassVar[OnlyWith] = {"quality": ("picture", ())}

    step: Literal["place"] = "place"
    takes: _Takes
    """Cleaned takes of one performer."""
    rig: ReadPath
    """The rig of the character."""
    out: LayerOut
    """The placement to write."""
    landmarks: ReadPath | None = None
    """Known positions of markers on the rig: .csv or .json, by point or by x, y, z in the rig's
    units; or a placement or binding, whose corrections are used."""
    picture: ImageOut | None = None
    """Picture to write of the markers on the rig, with the verdict (.jpg, .png or .exr)."""
    quality: Literal["draft", "final"] = "final"
    """`draft` omits soft shadows and ambient occlusion from the picture."""
    prim: PrimPath | None = None
    """Face in the rig's file, if it holds several."""

    def written_binding(self) -> Path:
        """Return the placement."""
        return self.out


class SelectSpec(Spec):
    """Choose the frames for an animator to tune, and propose weights for them.

    Few frames are chosen that span the performer's motion, eyelids as well as jaw, in order of
    their gain in coverage. Tuned pairs of an earlier selection are kept at their time codes.
    Pictures show the coverage of the takes by the pairs, and the placement of the markers on the
    rig; check the placement before tuning.

    If the takes carry weights instead of markers, as those of phones do, frames with distant
    weights are chosen, and the proposals are these weights, matched to the rig's shapes by name.
    `train-retarget` learns from the pairs once they are tuned.
    """

    example = (
        "usdface select kitchen.clean.take.usda --rig hero.usd --count 60 "
        "--out hero.references.usda"
    )
    module = "references.select"
    makes = "references"
    sidecars = (proposed_path, samples_path)
    cores = 2
    memory_mib = 8192

    never_with: ClassVar[NeverWith] = {"landmarks": ("placement",)}

    step: Literal["select"] = "select"
    takes: _Takes
    """Cleaned takes of one performer."""
    rig: ReadPath
    """The rig of the character."""
    out: LayerOut
    """The references asset to write: pair i at time code i."""
    count: Annotated[int, Field(ge=2, le=10_000)] = 100
    """Number of pairs."""
    method: Literal["viseme", "design", "both"] = "both"
    """How frames are chosen: `viseme`, one per viseme and emotion, and ten extremes per emotion;
    `design`, few frames that span the motion; `both`, visemes if phones are given, then design.
    Tuned pairs stay, and their coverage counts."""
    phones: Annotated[tuple[Path, ...], Reads()] = ()
    """Phone labels of the takes (`usdface phones`, or a TextGrid of another aligner), on the takes'
    clock: one file per take, in the same order."""
    emotions: tuple[Name, ...] = ()
    """Emotion of each take, in the same order. Default: as stored in the takes."""
    mapping: ReadPath | None = None
    """Mapping trained on the pairs tuned so far, which proposes the weights of the other pairs:
    closer to an animator's keys than proposals from the rig's geometry."""
    placement: ReadPath | None = None
    """Placement of the markers on the rig, from `usdface place`. Default: the markers are placed,
    and the placement is written next to the references, as NAME.placement.usda; its corrections
    are kept."""
    landmarks: ReadPath | None = None
    """Known positions of markers on the rig; see `usdface place`. Only without --placement."""
    picture: ImageOut | None = None
    """Picture of the coverage to write. Default: next to the references."""
    names: ReadPath | None = None
    """For takes that carry weights: table of pairs of shapes, as `usdface names` writes it.
    Default: matched by the meaning of the names."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    images: bool = True
    """Store the video frame of each pair as an image next to the references, if the take has a
    video. Without it, the images of an earlier selection are removed."""
    prim: PrimPath | None = None
    """Face in the rig's file, if it holds several."""

    @model_validator(mode="after")
    def _lists_go_with_takes(self) -> Self:
        for name in ("phones", "emotions"):
            given = len(getattr(self, name))
            if given not in (0, len(self.takes)):
                raise ValueError(
                    f"{given} {name} for {len(self.takes)} takes; give one for each, in order"
                )
        if self.method == "viseme" and not self.phones:
            raise ValueError(
                "viseme needs --phones (made by `usdface phones AUDIO --transcript TEXT`); or "
                "choose --method design"
            )
        return self

    def changes(self) -> tuple[Path, ...]:
        """Return the outputs, and the placement that is written next to them."""
        beside = self.written_binding()
        return self.outputs() if beside is None else (*self.outputs(), beside)

    def written_binding(self) -> Path | None:
        """Return the placement that is written next to the references, without --placement."""
        return None if self.placement is not None else placement_path(self.out)

    def picture_path(self) -> Path:
        """Return the path of the picture of the coverage."""
        return self.picture or coverage_path(self.out)


class ReferencesImportSpec(MovedRigSpec, WeightTableSpec):
    """Import tuned weights into a references asset.

    Weights are matched to the rig by the meaning of the shapes' names and to the pairs by frame.
    Shapes missing from the file are set to 0 in untuned pairs, and keep their weights in tuned
    ones. The layer of proposals does not change, and tuned weights are replaced only at the frames
    in the file. The picture of the coverage that `select` drew is drawn again.
    """

    example = "usdface references import hero.references.usda --weights tuned.csv"
    module = "references.import_"
    makes = "references"

    step: Literal["references-import"] = "references-import"
    references: Annotated[FilePath, Reads(alone=True), Positional()]
    """The references asset written by `usdface select`."""
    weights: ReadPath
    """Table of weights, in the formats of `ingest` (.csv, .json or .npy; a `take` column
    distinguishes takes, and rows without a frame number count from 1), or .usd with an animation,
    at the takes' frames or at the pairs' time codes (--at pairs); or other references, whose tuned
    pairs are imported by take and frame."""
    shapes: ReadPath | None = None
    """Names of the columns of a .npy matrix of weights, as for `ingest`."""
    names: ReadPath | None = None
    """Table of pairs of shapes, as `usdface names` writes it. Default: matched by the meaning of
    the names."""
    at: Literal["frames", "pairs", "video"] = "frames"
    """Meaning of the frame numbers: `frames` of the takes, time codes of the `pairs`, or frames of
    another take of the same performance with the same `video`: for references of the video's
    landmarks, --weights is then the solve of that take, for example of optical markers."""
    keep_proposed: bool = False
    """Keep the proposals of shapes missing from the file, for keys set on top of them."""
    author: str = ""
    """Author of the weights, stored with the pairs: `train` brings the keys of several authors to
    one gain."""

    def outputs(self) -> tuple[Path, ...]:
        """Return the layer of tuned weights."""
        return (tuned_path(self.references),)

    def changes(self) -> tuple[Path, ...]:
        """Return that layer and the asset that composes it."""
        return (*self.outputs(), self.references)


class ReferencesFromEditsSpec(MovedRigSpec):
    """Add frames that an animator edited to the references, as tuned pairs.

    Frames are chosen that differ from one another, and at which edits have full strength, outside
    their fades. The existing pairs of the references do not change.
    """

    example = (
        "usdface references from-edits kitchen.hero.usda --references hero.references.usda "
        "--out hero.v2.references.usda"
    )
    in_place = True
    module = "references.from_edits"
    makes = "references"
    sidecars = (proposed_path, samples_path)
    traces = ("performances",)

    step: Literal["references-from-edits"] = "references-from-edits"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Edited performances. Each stores the take it was made from."""
    take: Annotated[tuple[Path, ...], Reads()] = ()
    """The takes they were made from, if their files have moved: one per performance, in order, or
    one for all."""
    references: ReadPath
    """The references to add to."""
    out: LayerOut
    """The references asset to write."""
    count: Annotated[int, Field(ge=1, le=10_000)] = 20
    """Largest number of frames taken from each performance."""


class ReferencesAddSpec(MovedRigSpec):
    """Add frames of a performance to the references, to be tuned.

    The weights of the performance become their proposals. Use it for frames that look wrong in a
    review: given by number, or as notes of a report. The existing pairs of the references do not
    change.
    """

    example = (
        "usdface references add kitchen.hero.usda --references hero.references.usda "
        "--frames 434,1182 --out hero.references.usda"
    )
    in_place = True
    module = "references.add"
    makes = "references"
    sidecars = (proposed_path, samples_path)
    traces = ("performance",)

    step: Literal["references-add"] = "references-add"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance. It stores the take it was made from."""
    take: ReadPath | None = None
    """The take it was made from, if its file has moved."""
    references: ReadPath
    """The references to add to."""
    out: LayerOut
    """The references asset to write; it may be that of --references."""
    frames: ChosenFrames | None = None
    """Frames to add, as 434,1182 or FIRST-LAST."""
    notes: ReadPath | None = None
    """Notes saved by a report: the frames of open notes are added."""

    @model_validator(mode="after")
    def _some_frames(self) -> Self:
        if self.frames is None and self.notes is None:
            raise ValueError("give the frames to add by --frames, or --notes of a report")
        return self


class ReferencesCoverageSpec(MovedRigSpec):
    """Measure the coverage of takes by references.

    Prints the share of the motion that the pairs span, per region of the face, the frames with the
    lowest coverage, and the frames that would add most coverage if tuned. The picture shows the
    coverage over time.
    """

    example = (
        "usdface references coverage hero.references.usda kitchen.clean.take.usda "
        "--out kitchen.coverage.png"
    )
    module = "references.coverage"

    step: Literal["references-coverage"] = "references-coverage"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Cleaned takes of the same performer: those the frames were selected from, or others."""
    out: ImageOut
    """Picture to write: .jpg, .png or .exr."""
    tuned_only: bool = False
    """Count tuned pairs only, as for a mapping trained on them."""


class ReferenceSheetSpec(MovedRigSpec):
    """Draw the reference pairs for an animator to work from, on screen or on paper.

    Each pair shows the video frame, the markers and the rig at the pair's current weights, with
    viseme, emotion, frame and the largest weights.
    """

    example = (
        "usdface references sheet hero.references.usda --takes kitchen.clean.take.usda "
        "--paper --out hero.references.jpg"
    )
    module = "references.sheet"

    step: Literal["references-sheet"] = "references-sheet"
    references: Annotated[FilePath, Reads(assets=True), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Reads(assets=True)] = ()
    """Takes that the frames were selected from. Without them, video and timecode are not shown."""
    out: ImageOut
    """Picture to write: .jpg, .png or .exr. A page has six pairs; further pages are NAME.2.jpg and
    so on."""
    pairs: Frames | None = None
    """Pairs to draw, as FIRST-LAST. Default: all."""
    paper: bool = False
    """Draw dark on white, for printing, with lines to write on."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 280
    """Height of an image in pixels."""
    quality: Literal["draft", "final"] = "final"
    """`draft` omits soft shadows and ambient occlusion."""
