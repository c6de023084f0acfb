"""What materials say of a mesh's colours: of the whole mesh, and of subsets of its faces.

Pictures show constants: a material's UsdPreviewSurface, its diffuse colour and opacity. Textures
and other shaders are not drawn, and are told, so that nobody takes plain skin for a lost texture.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from usdface.core.arrays import FloatArray

SURFACE = "UsdPreviewSurface"
TEXTURE = "UsdUVTexture"
PRIMVAR = "UsdPrimvarReader_float3"


@dataclass(frozen=True)
class Look:
    """The colours of a mesh's faces."""

    face_colors: FloatArray | None
    """(faces, 4): linear red, green, blue and opacity; NaN where nothing is said of a face."""
    undrawn: tuple[str, ...]
    """What is said in ways that pictures do not show."""


@dataclass(frozen=True)
class _Surface:
    """What one material says: four numbers, NaN where it does not, and what is left out."""

    color: tuple[float, float, float, float]
    undrawn: str = ""


_NOTHING = (np.nan, np.nan, np.nan, np.nan)


def read_look(prim: Usd.Prim, face_count: int) -> Look:
    """Read what colours the faces of a mesh have by its materials, else by ``displayColor``.

    Bindings of subsets (family ``materialBind``) are stronger than the mesh's own, and a material
    is stronger than a display colour, as in a renderer. A display colour per point is not read
    here.
    """
    colors = _display_colors(prim, face_count)
    undrawn = list[str]()

    def lay_on(bound: Usd.Prim, faces: slice | np.ndarray) -> None:
        material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial(
            UsdShade.Tokens.preview
        )
        if material:
            surface = _read_surface(material)
            if not np.isnan(surface.color[0]):
                colors[faces] = surface.color
            if surface.undrawn:
                undrawn.append(surface.undrawn)

    lay_on(prim, slice(None))
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        where = f"<{subset.GetPath()}>"
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            undrawn.append(f"{where}: a subset of {subset.GetElementTypeAttr().Get()}s, not faces")
            continue
        faces = np.array(subset.GetIndicesAttr().Get() or [], np.int64)
        inside = faces[(faces >= 0) & (faces < face_count)]
        if len(inside) < len(faces):
            undrawn.append(
                f"{where}: {len(faces) - len(inside)} of its {len(faces)} indices name no face"
            )
        lay_on(subset.GetPrim(), inside)
    known = not np.isnan(colors).all()
    return Look(colors if known else None, tuple(dict.fromkeys(undrawn)))


def _display_colors(prim: Usd.Prim, face_count: int) -> FloatArray:
    """Return a display colour of each face where the mesh has one; NaN otherwise."""
    colors = np.full((face_count, 4), np.nan)
    primvar = UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
    if not (primvar and primvar.HasAuthoredValue()):
        return colors
    if primvar.GetInterpolation() == UsdGeom.Tokens.uniform:
        values = np.array(primvar.ComputeFlattened() or [], np.float64).reshape(-1, 3)
        if len(values) == face_count:
            colors[:, :3], colors[:, 3] = values, 1.0
    return colors


def _read_surface(material: UsdShade.Material) -> _Surface:
    where = f"<{material.GetPath()}>"
    shader, _, _ = material.ComputeSurfaceSource()
    if not shader:
        return _Surface(_NOTHING, f"{where}: has no surface that a preview shows")
    kind = shader.GetShaderId()
    if kind != SURFACE:
        return _Surface(_NOTHING, f"{where}: is a {kind or 'shader'}, not a {SURFACE}")
    color, left_out = _constant(shader.GetInput("diffuseColor"))
    opacity, _ = _constant(shader.GetInput("opacity"))
    if color is None:
        return _Surface(_NOTHING, f"{where}: {left_out}" if left_out else "")
    red, green, blue = (max(float(each), 0.0) for each in color)
    return _Surface((red, green, blue, 1.0 if opacity is None else float(opacity)))


def _constant(given: UsdShade.Input | None) -> tuple[Any, str]:
    """Return an input's constant, else None and what it is connected to instead."""
    if not given:
        return None, ""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(given):
        if UsdShade.Utils.GetType(attribute.GetName()) != UsdShade.AttributeType.Output:
            value = attribute.Get()
            return (value, "") if value is not None else (None, "")
        return None, _connected(UsdShade.Shader(attribute.GetPrim()))
    return None, ""


def _connected(node: UsdShade.Shader) -> str:
    kind = node.GetShaderId()
    if kind == PRIMVAR:  # most read displayColor, which is shown where the mesh has it
        name = node.GetInput("varname")
        read = name.Get() if name else None
        return "" if str(read) == "displayColor" else f"its colour is primvar {read}"
    if kind == TEXTURE:
        file = node.GetInput("file")
        asset = file.Get() if file else None
        path = asset.path if isinstance(asset, Sdf.AssetPath) else ""
        return f"its colour is a texture{f', {path}' if path else ''}"
    return f"its colour is made by {kind or node.GetPath()}"
