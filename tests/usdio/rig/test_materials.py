"""Colours of faces as materials give them, and what pictures leave out of them."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from usdface.usdio.rig.materials import read_face_colors

FACES = 6


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(tmp_path / "head.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/Head/face")
    mesh.CreateFaceVertexCountsAttr([4] * FACES)
    mesh.CreateFaceVertexIndicesAttr(list(range(4)) * FACES)
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    return stage


def face_of(stage: Usd.Stage) -> Usd.Prim:
    return stage.GetPrimAtPath("/Head/face")


def material(stage: Usd.Stage, name: str, color=None, **inputs: object) -> UsdShade.Material:
    made = UsdShade.Material.Define(stage, f"/Head/looks/{name}")
    shader = UsdShade.Shader.Define(stage, f"/Head/looks/{name}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    if color is not None:
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    for key, value in inputs.items():
        shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    made.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return made


def bind(prim: Usd.Prim, made: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(made)


def subset(stage: Usd.Stage, name: str, faces: list[int], made: UsdShade.Material) -> Usd.Prim:
    prim = UsdShade.MaterialBindingAPI.Apply(face_of(stage)).CreateMaterialBindSubset(
        name, Vt.IntArray(faces)
    )
    bind(prim.GetPrim(), made)
    return prim.GetPrim()


def feed(stage: Usd.Stage, made: UsdShade.Material, kind: str) -> UsdShade.Shader:
    """Connect a material's colour to a node instead of a constant."""
    path = made.GetPath()
    node = UsdShade.Shader.Define(stage, f"{path}/node")
    node.CreateIdAttr(kind)
    surface = UsdShade.Shader(stage.GetPrimAtPath(f"{path}/surface"))
    slot = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    slot.ConnectToSource(node.ConnectableAPI(), "rgb")
    return node


def test_subsets_are_stronger_than_the_mesh_and_the_mesh_than_what_is_above(stage) -> None:
    bind(stage.GetPrimAtPath("/Head"), material(stage, "above", (0.9, 0.9, 0.9)))
    assert np.allclose(read_face_colors(face_of(stage), FACES)[0], [0.9, 0.9, 0.9, 1])
    bind(face_of(stage), material(stage, "skin", (0.5, 0.3, 0.2)))
    subset(stage, "lips", [1, 4], material(stage, "red", (0.7, 0.1, 0.1), opacity=0.25))
    colors, undrawn = read_face_colors(face_of(stage), FACES)
    expected = np.tile([0.5, 0.3, 0.2, 1.0], (FACES, 1))
    expected[[1, 4]] = 0.7, 0.1, 0.1, 0.25
    np.testing.assert_allclose(colors, expected, atol=1e-7)
    assert undrawn == ()


def test_a_colour_given_through_the_materials_interface_is_a_constant(stage) -> None:
    made = material(stage, "skin")
    public = made.CreateInput("tone", Sdf.ValueTypeNames.Color3f)
    public.Set(Gf.Vec3f(0.4, 0.2, 0.1))
    surface = UsdShade.Shader(stage.GetPrimAtPath("/Head/looks/skin/surface"))
    slot = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    slot.ConnectToSource(public)
    bind(face_of(stage), made)
    np.testing.assert_allclose(
        read_face_colors(face_of(stage), FACES)[0][0], [0.4, 0.2, 0.1, 1], atol=1e-7
    )


def test_a_texture_is_told_and_the_rest_is_shown(stage) -> None:
    made = material(stage, "skin")
    node = feed(stage, made, "UsdUVTexture")
    node.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath("skin.<UDIM>.exr"))
    bind(face_of(stage), made)
    subset(stage, "lips", [0], material(stage, "red", (0.7, 0.1, 0.1)))
    colors, undrawn = read_face_colors(face_of(stage), FACES)
    assert undrawn == ("</Head/looks/skin>: its colour is a texture, skin.<UDIM>.exr",)
    assert np.isnan(colors[1:]).all()
    assert not np.isnan(colors[0]).any()


def test_a_reader_of_the_display_colour_leaves_it_to_the_display_colour(stage) -> None:
    made = material(stage, "skin")
    node = feed(stage, made, "UsdPrimvarReader_float3")
    node.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    bind(face_of(stage), made)
    assert read_face_colors(face_of(stage), FACES) == read_face_colors(
        stage.GetPrimAtPath("/Head/face"), FACES
    )
    assert read_face_colors(face_of(stage), FACES)[1] == ()
    node.GetInput("varname").Set("groom")
    assert "primvar groom" in read_face_colors(face_of(stage), FACES)[1][0]


def test_a_display_colour_of_each_face_holds_where_no_material_does(stage) -> None:
    primvar = UsdGeom.Mesh(face_of(stage)).CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform)
    values = np.random.default_rng(0).random((FACES, 3)).astype(np.float32)
    primvar.Set(Vt.Vec3fArray.FromNumpy(values))
    subset(stage, "lips", [2], material(stage, "red", (0.7, 0.1, 0.1)))
    look = read_face_colors(face_of(stage), FACES)[0]
    values[2] = 0.7, 0.1, 0.1
    np.testing.assert_allclose(look[:, :3], values, atol=1e-7)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("shader", "is a ND_standard_surface_surfaceshader, not a UsdPreviewSurface"),
        ("empty", "has no surface that a preview shows"),
        ("indices", "2 of its 3 indices name no face"),
        ("points", "a subset of points, not faces"),
    ],
)
def test_what_is_not_drawn_is_told(stage, fault: str, told: str) -> None:
    made = material(stage, "skin", (0.5, 0.3, 0.2))
    if fault == "shader":
        UsdShade.Shader(stage.GetPrimAtPath("/Head/looks/skin/surface")).SetShaderId(
            "ND_standard_surface_surfaceshader"
        )
    if fault == "empty":
        made = UsdShade.Material.Define(stage, "/Head/looks/nothing")
    prim = subset(stage, "lips", [1, FACES, -1] if fault == "indices" else [1], made)
    if fault == "points":
        UsdGeom.Subset(prim).GetElementTypeAttr().Set("point")
    assert told in read_face_colors(face_of(stage), FACES)[1][0]


def test_a_mesh_without_materials_has_no_look(stage) -> None:
    assert read_face_colors(face_of(stage), FACES)[0] is None
    bind(face_of(stage), material(stage, "unsaid"))  # the shader's own grey is nobody's choice
    assert read_face_colors(face_of(stage), FACES)[0] is None
