"""Specs of meshes without shapes: bind, deform, make-shapes."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import (
    Device,
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

Landmark = Annotated[str, Field(pattern=r"^[^=]+=\d+$", max_length=300, examples=["nose_tip=1203"])]


def corrected_path(binding: Path) -> Path:
    """Return the layer of a binding that holds what people corrected."""
    return binding.with_name(f"{binding.stem}.corrected.usda")


def proposed_binding_path(binding: Path) -> Path:
    """Return the layer of a binding that holds the proposal."""
    return binding.with_name(f"{binding.stem}.proposed.usda")


class BindSpec(Spec):
    """Find where a take's markers sit on a mesh, which needs no shapes and no rig.

    The layer it writes shows the mesh with a ball at each marker. Move a ball, or name another
    face or point, in the corrected layer beside it or in a stronger one: binding again keeps that.
    """

    example: ClassVar[str] = (
        "usdface bind kitchen.clean.take.usda scan.usdc --out scan.binding.usda "
        "--landmarks nose_tip=3437,chin=60,brow_L3=9445 --picture scan.binding.jpg"
    )
    module: ClassVar[str] = "surface.bind"

    step: Literal["bind"] = "bind"
    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mesh: Annotated[FilePath, Reads(), Positional()]
    """The face: any USD file with a mesh."""
    out: LayerOut
    """The binding to open and to correct."""
    landmarks: tuple[Landmark, ...] = ()
    """Markers whose point on the mesh is known, as NAME=POINT,...; three or more that are not on a
    line, unless the mesh has shapes to compare the motion with."""
    mesh_prim: PrimPath | None = None
    """The mesh in its file, where it holds several."""
    picture: ImageOut | None = None
    """Draw the markers on the mesh, named, the doubtful ones marked (.jpg, .png or .exr)."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves soft shadows and occlusion out of the picture."""


_Method = Literal["gp", "rbf"]
_Sampler = Literal["hmc", "map", "shared"]
_Metric = Literal["dijkstra", "dijkstra-diagonals", "heat"]


class SurfaceSpec(Spec):
    """What deforming and making shapes have in common."""

    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mesh: ReadPath
    """The face: any USD file with a mesh; referenced, never written."""
    binding: ReadPath | None = None
    """Where the markers sit, from `usdface bind`; without it they are bound anew."""
    landmarks: tuple[Landmark, ...] = ()
    """Markers whose point on the mesh is known, as NAME=POINT,...; only without --binding."""
    mesh_prim: PrimPath | None = None
    """The mesh in its file, where it holds several."""
    method: _Method = "gp"
    """`gp` smooths noise and knows how sure it is; `rbf` passes through every marker."""
    sampler: _Sampler = "shared"
    """How `gp` treats what it cannot know: `hmc` averages 200 settings for each frame and axis
    (Wang et al. 2006), `shared` 200 settings for the whole take, `map` takes the best."""
    blend: Annotated[float, Field(ge=0.0, le=1.0)] = 0.39
    """Share of the distance along the surface in the distance that counts; the rest is the
    straight line (Wang et al. 2006)."""
    choose_blend: bool = False
    """Choose that share by cross-validation on the take instead."""
    metric: _Metric = "dijkstra-diagonals"
    """How distance along the surface is measured: the paper's edges, edges with the diagonals of
    faces, or the heat method."""
    length_scale: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = None
    """Distance over which points move alike, in millimetres; fitted to the take by default."""

    reach: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = None
    """Points further than this from every marker stay where they are, in millimetres along the
    surface; motion fades from half of it on. Four times the markers' spacing by default."""

    device: Device = "cpu"
    """Where frames are sampled and predicted: `cpu`, a graphics card as `cuda` or `cuda:1` (by
    torch or cupy, where installed), or `torch`, which is torch on the processor."""
    precision: Literal["single", "double"] = "single"
    """Of sampling and prediction. Single is faster; in double every device gives the same result to
    a millionth of a millimetre."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves soft shadows and occlusion out of the picture."""

    @model_validator(mode="after")
    def _landmarks_are_for_binding(self) -> Self:
        if self.landmarks and self.binding is not None:
            raise ValueError("--landmarks are for binding anew; a --binding has its own")
        return self


class DeformSpec(SurfaceSpec):
    """Move a mesh that has no shapes by a take's markers: points over time.

    Writes NAME.usda to open, and NAME.points.usdc, which holds only overs on the mesh: points,
    extent, normals where the mesh has them, and how sure each point is (primvar face:uncertainty,
    millimetres). Long takes are written as value clips.
    """

    example: ClassVar[str] = (
        "usdface deform kitchen.clean.take.usda --mesh scan.usdc --binding scan.binding.usda "
        "--out kitchen.scan.usda --picture kitchen.scan.jpg"
    )
    module: ClassVar[str] = "surface.deform"

    step: Literal["deform"] = "deform"
    out: LayerOut
    """The moving mesh to open."""
    frames: Frames | None = None
    """These frames only, as FIRST-LAST."""
    prim: PrimPath | None = None
    """Where the mesh's asset is put in the new layer; its own place by default."""
    uncertainty: bool = True
    """Write how sure each point is; a third of the file."""
    clip_mb: Annotated[int, Field(ge=1, le=1 << 20)] = 512
    """Takes larger than this are written as value clips of this size."""
    picture: ImageOut | None = None
    """Compare Euclidean, geodesic and blended distance, noise smoothed, and the uncertainty
    (.jpg, .png or .exr)."""
    rows: Annotated[int, Field(ge=1, le=60)] = 6
    """How many frames the picture shows."""
    picture_noise: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Shake the markers by so many millimetres in the picture, to see what smoothing is worth."""


_ShapeFrame = Annotated[
    str, Field(pattern=r"^-?\d+(=.+)?$", max_length=200, examples=["120", "120=smile"])
]


class MakeShapesSpec(SurfaceSpec):
    """Make a rig of a mesh that has none: chosen frames of a take become BlendShapes.

    The rig is a new asset that references the mesh: its own file stays as it is. `select`, `train`
    and `map` take the rig as any other.
    """

    example: ClassVar[str] = (
        "usdface make-shapes kitchen.clean.take.usda --mesh scan.usdc "
        "--binding scan.binding.usda --count 8 --out scan.rig.usda"
    )
    module: ClassVar[str] = "surface.make_shapes"

    step: Literal["make-shapes"] = "make-shapes"
    out: LayerOut
    """The rig."""
    count: Annotated[int, Field(ge=1, le=1000)] = 8
    """How many frames to choose where none are given: those that differ most."""
    shape_frames: tuple[_ShapeFrame, ...] = ()
    """Frames to make shapes of, as FRAME or FRAME=NAME,..."""
    names: ReadPath | None = None
    """Frames to make shapes of, from a .csv with the columns frame and name."""
    references: ReadPath | None = None
    """Make shapes of the pairs of a references asset that are of this take, named by viseme or
    emotion where the pairs have one."""
    name: Name = "Face"
    """Name of the rig's top prim."""
    least_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.02
    """Points that a shape moves less are left out of it, in millimetres."""
    picture: ImageOut | None = None
    """Draw the shapes (.jpg, .png or .exr)."""

    @model_validator(mode="after")
    def _one_way_to_choose(self) -> Self:
        ways = [bool(self.shape_frames), self.names is not None, self.references is not None]
        if sum(ways) > 1:
            raise ValueError("frames are chosen by one of --shape-frames, --names and --references")
        return self
