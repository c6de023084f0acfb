"""What `usdface deform` is told."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import (
    Device,
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)
from usdface.specs.bind import Landmark

Method = Literal["gp", "rbf"]
Sampler = Literal["hmc", "map", "shared"]
Metric = Literal["dijkstra", "dijkstra-diagonals", "heat"]


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
    method: Method = "gp"
    """`gp` smooths noise and knows how sure it is; `rbf` passes through every marker."""
    sampler: Sampler = "shared"
    """How `gp` treats what it cannot know: `hmc` averages 200 settings for each frame and axis
    (Wang et al. 2006), `shared` 200 settings for the whole take, `map` takes the best."""
    blend: Annotated[float, Field(ge=0.0, le=1.0)] = 0.39
    """Share of the distance along the surface in the distance that counts; the rest is the
    straight line (Wang et al. 2006)."""
    choose_blend: bool = False
    """Choose that share by cross-validation on the take instead."""
    metric: Metric = "dijkstra-diagonals"
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
