"""Specs of meshes and rigs: bind, deform, make-shapes, logic."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.core.sidecars import proposed_path
from usdface.specs.base import Name, NeverWith, OnlyWith, Positional, Spec, WeightTableSpec
from usdface.specs.paths import FilePath, Frames, ImageOut, LayerOut, PrimPath, ReadPath, Reads

Landmark = Annotated[str, Field(pattern=r"^[^=]+=\d+$", max_length=300, examples=["nose_tip=1203"])]


class BindSpec(Spec):
    """Bind a take's markers to points of a mesh, which needs no shapes and no rig.

    The binding shows the mesh with a ball at each marker. To correct a marker, move its ball, or
    set another face or point, in the corrected layer next to the binding or in a stronger layer.
    Binding again keeps corrections.
    """

    example = (
        "usdface bind kitchen.clean.take.usda scan.usdc --out scan.binding.usda "
        "--landmarks nose_tip=3437,chin=60,brow_L3=9445 --picture scan.binding.jpg"
    )
    module = "surface.bind"
    sidecars = (proposed_path,)
    only_with: ClassVar[OnlyWith] = {"quality": ("picture", ())}

    step: Literal["bind"] = "bind"
    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mesh: Annotated[FilePath, Reads(), Positional()]
    """The face: any USD file with a mesh."""
    out: LayerOut
    """The binding to write."""
    landmarks: tuple[Landmark, ...] = ()
    """Known points of markers on the mesh, as NAME=POINT,...: three or more, not on one line,
    unless the mesh has shapes to compare the motion with."""
    mesh_prim: PrimPath | None = None
    """Mesh in its file, if it holds several."""
    picture: ImageOut | None = None
    """Picture to write of the markers on the mesh, with names and uncertain markers highlighted
    (.jpg, .png or .exr)."""
    quality: Literal["draft", "final"] = "final"
    """`draft` omits soft shadows and ambient occlusion from the picture."""

    def written_binding(self) -> Path:
        """Return the binding."""
        return self.out


_Method = Literal["gp", "rbf"]

_Sampler = Literal["hmc", "shared"]

_Metric = Literal["dijkstra", "dijkstra-diagonals"]

_Positive = Annotated[float, Field(gt=0.0, le=1e6)]

_FOR_GP = ("sampler", "samples", "burn_in", "covariance", "priors", "prior_spread", "length_scale")
"""Options of the Gaussian process only."""


class SurfaceSpec(Spec):
    """Options common to `deform` and `make-shapes`."""

    only_with: ClassVar[OnlyWith] = {"quality": ("picture", ())}
    never_with: ClassVar[NeverWith] = {"blend": ("choose_blend",), "landmarks": ("binding",)}

    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mesh: ReadPath
    """The face: any USD file with a mesh. It is referenced and does not change."""
    binding: ReadPath | None = None
    """Binding of the markers, from `usdface bind`. Default: the markers are bound automatically."""
    landmarks: tuple[Landmark, ...] = ()
    """Known points of markers on the mesh, as NAME=POINT,...; only without --binding."""
    mesh_prim: PrimPath | None = None
    """Mesh in its file, if it holds several."""
    method: _Method = "gp"
    """`gp`, a Gaussian process, smooths noise and estimates its uncertainty; `rbf` interpolates
    every marker."""
    sampler: _Sampler = "shared"
    """Treatment of the hyper-parameters of `gp`: `hmc` averages samples for each frame and axis, as
    published (Wang et al. 2006); `shared` samples for the whole take, with the least jitter."""
    samples: Annotated[int, Field(ge=8, le=10_000)] = 200
    """Number of samples that `hmc` and `shared` average; 200 in the paper."""
    burn_in: Annotated[int, Field(ge=8, le=10_000)] = 40
    """Number of samples before those, in which a chain tunes its step; the paper gives none."""
    covariance: Literal["creased", "published"] = "creased"
    """Covariance of the motion of points over their distance. `published` is eq. 7 of the paper,
    which is indefinite for distances along a surface: its negative part is cut off, and its size
    is in the result. `creased` is rarely indefinite, and its intervals are calibrated."""
    priors: tuple[_Positive, _Positive, _Positive, _Positive] = (9.0, 0.05, 4.0, 1.0)
    """Medians of the log-normal priors of the hyper-parameters, in mm²: motion beyond a linear
    field, noise of the markers, motion common to all, linear motion (v0, v1, a0, a1 of eq. 7), on
    the performer's face; scaled by the squared ratio of the mesh's size to it. The paper has no
    priors."""
    prior_spread: Annotated[float, Field(gt=0.0, le=10.0)] = 1.5
    """Standard deviation of the logarithms. At 10 the priors are almost flat."""
    blend: Annotated[float, Field(ge=0.0, le=1.0)] = 0.39
    """Share of the distance along the surface, 0 to 1; the rest is the straight-line distance (Wang
    et al. 2006)."""
    choose_blend: bool = False
    """Choose --blend by cross-validation on the take."""
    folds: bool = True
    """Let points inside of lips and lids follow the markers of the same lip or lid. The paper has
    no such rule."""
    metric: _Metric = "dijkstra-diagonals"
    """Distance along the surface: over edges (`dijkstra`, as published), or over edges and face
    diagonals."""
    length_scale: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = None
    """Distance over which the motion of points is correlated, in mm; 1 in the paper, in a unit that
    it does not state. Default: fitted to the take."""
    reach: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = None
    """Distance from every marker beyond which points do not move, in mm along the surface; motion
    fades from half of it. 10000 for the field as published. Default: four times the root mean
    square distance of markers to the nearest other."""
    quality: Literal["draft", "final"] = "final"
    """`draft` omits soft shadows and ambient occlusion from the picture."""

    @model_validator(mode="after")
    def _options_of_the_method(self) -> Self:
        given = [name for name in _FOR_GP if self.is_given(name)]
        if self.method == "rbf" and given:
            options = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            raise ValueError(f"--method rbf does not use {options}; leave it out")
        return self


class DeformSpec(SurfaceSpec):
    """Animate the points of a mesh that has no shapes by a take's markers.

    Writes NAME.usda, the layer to open, and NAME.points.usdc, which holds only overs on the mesh:
    points, extent, normals if the mesh has them, and the uncertainty of each point (primvar
    face:uncertainty, mm). Long takes are written as value clips.
    """

    example = (
        "usdface deform kitchen.clean.take.usda --mesh scan.usdc --binding scan.binding.usda "
        "--out kitchen.scan.usda --picture kitchen.scan.jpg"
    )
    module = "surface.deform"
    cores = 2
    memory_mib = 8192
    only_with: ClassVar[OnlyWith] = {
        **SurfaceSpec.only_with,
        "rows": ("picture", ()),
        "picture_noise": ("picture", ()),
    }

    step: Literal["deform"] = "deform"
    out: LayerOut
    """The animated mesh to write."""
    frames: Frames | None = None
    """Frames to deform, as FIRST-LAST. Default: all."""
    prim: PrimPath | None = None
    """Prim path of the mesh's asset in the new layer. Default: the same as in its file."""
    uncertainty: bool = True
    """Write the uncertainty of each point, a third of the file's size."""
    clip_mb: Annotated[int, Field(ge=1, le=1 << 20)] = 512
    """Largest size of a points file, in MB. Longer takes are written as value clips of this
    size."""
    picture: ImageOut | None = None
    """Picture to write: Euclidean, geodesic and blended distance, smoothed noise, and uncertainty
    (.jpg, .png or .exr)."""
    rows: Annotated[int, Field(ge=1, le=60)] = 6
    """Number of frames in the picture."""
    picture_noise: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Noise added to the markers in the picture, in mm, to show the effect of smoothing."""


_ShapeFrame = Annotated[
    str, Field(pattern=r"^-?\d+(=.+)?$", max_length=200, examples=["120", "120=smile"])
]


class MakeShapesSpec(SurfaceSpec):
    """Make a BlendShape rig of a mesh from frames of a take.

    The rig is a new asset that references the mesh, whose file does not change. `select`, `train`
    and `map` use it like any other rig.
    """

    example = (
        "usdface make-shapes kitchen.clean.take.usda --mesh scan.usdc "
        "--binding scan.binding.usda --count 8 --out scan.rig.usda"
    )
    module = "surface.make_shapes"
    cores = 2
    memory_mib = 8192
    never_with: ClassVar[NeverWith] = {
        **SurfaceSpec.never_with,
        "count": ("shape_frames", "names", "references"),
        "shape_frames": ("names", "references"),
        "names": ("references",),
    }

    step: Literal["make-shapes"] = "make-shapes"
    out: LayerOut
    """The rig to write."""
    count: Annotated[int, Field(ge=1, le=1000)] = 8
    """Number of frames to choose if none are given: those that differ most."""
    shape_frames: tuple[_ShapeFrame, ...] = ()
    """Frames to make shapes of, as FRAME or FRAME=NAME,..."""
    names: ReadPath | None = None
    """Frames to make shapes of: .csv with the columns frame and name."""
    references: ReadPath | None = None
    """Make shapes of the pairs of a references asset that belong to this take, named by viseme or
    emotion if the pairs have one."""
    name: Name = "Face"
    """Name of the rig's top prim."""
    least_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.02
    """Smallest displacement of a point that is stored in a shape, in mm."""
    picture: ImageOut | None = None
    """Picture of the shapes to write (.jpg, .png or .exr)."""


class LogicSpec(WeightTableSpec):
    """Define which shapes of a rig are driven by others: combinations, correctives, in-betweens.

    Such shapes are evaluated, not learned: `select`, `train` and the tuning page show only the
    others, and every layer holds the evaluated weights. The logic is read from names (`A_B` where A
    and B are shapes of the rig), from a table or a Simplex definition, or inferred from weights of
    a rig that evaluates it. The rig's file does not change: use the new asset, which references it,
    in its place.
    """

    example = "usdface logic hero.usd --naming --out hero.logic.usda"
    module = "surface.logic"
    only_with: ClassVar[OnlyWith] = {"weight_unit": ("weights", ())}

    step: Literal["logic"] = "logic"
    rig: Annotated[FilePath, Reads(), Positional()]
    """The rig."""
    out: LayerOut
    """The rig with its logic to write."""
    naming: bool = False
    """Read combinations from names: `A_B` and `A__B`, and `A50` for A at half its weight, if all
    parts are shapes of the rig."""
    definition: ReadPath | None = None
    """Table with the columns shape, parts, and optionally mode (product, minimum or smooth),
    weights and spans, parts separated by spaces (.csv, or .json with lists); or a Simplex
    definition (.json)."""
    weights: ReadPath | None = None
    """Weights of the rig with its correctives evaluated, to infer the logic from: .csv or .json
    with a `frame` column, or USD."""
    driven: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = ()
    """Shapes whose logic is inferred from --weights, as patterns,..."""
    prim: PrimPath | None = None
    """Face in the rig's file, if it holds several."""

    @model_validator(mode="after")
    def _has_a_source(self) -> Self:
        if not (self.naming or self.definition or self.weights):
            raise ValueError("give a source: --naming, --definition or --weights")
        if bool(self.weights) != bool(self.driven):
            raise ValueError("--weights and --driven go together; name the driven shapes and both")
        return self
