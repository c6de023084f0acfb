"""Colours of a mesh's faces by materials of the mesh and of subsets.

Pictures show constant diffuse colours and opacities of UsdPreviewSurface. Textures and other
shaders are not drawn, and are listed.
"""

from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from usdface.core.arrays import FloatArray

SURFACE = "UsdPreviewSurface"
TEXTURE = "UsdUVTexture"
PRIMVAR = "UsdPrimvarReader_float3"


def read_face_colors(prim: Usd.Prim, face_count: int) -> tuple[FloatArray | None, tuple[str, ...]]:
    """Return the colours of a mesh's faces by its materials, else by ``displayColor``.

    (faces, 4): linear red, green, blue and opacity, NaN if unknown; None if all are. And the parts
    of materials that pictures leave out.

    Bindings of subsets (family ``materialBind``) are stronger than the mesh's, and materials are
    stronger than display colours, as in a renderer. Display colours per point are not read.
    """
    colors = _display_colors(prim, face_count)
    undrawn = list[str]()

    def apply_material(bound: Usd.Prim, faces: slice | np.ndarray) -> None:
        material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial(
            UsdShade.Tokens.preview
        )
        if material:
            color, left_out = _read_surface(material)
            if color is not None:
                colors[faces] = color
            if left_out:
                undrawn.append(left_out)

    apply_material(prim, slice(None))
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
        apply_material(subset.GetPrim(), inside)
    known = not np.isnan(colors).all()
    return (colors if known else None), tuple(dict.fromkeys(undrawn))


def _display_colors(prim: Usd.Prim, face_count: int) -> FloatArray:
    """Return the display colours of faces, or NaN."""
    colors = np.full((face_count, 4), np.nan)
    primvar = UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
    if not (primvar and primvar.HasAuthoredValue()):
        return colors
    if primvar.GetInterpolation() == UsdGeom.Tokens.uniform:
        values = np.array(primvar.ComputeFlattened() or [], np.float64).reshape(-1, 3)
        if len(values) == face_count:
            colors[:, :3], colors[:, 3] = values, 1.0
    return colors


def _read_surface(
    material: UsdShade.Material,
) -> tuple[tuple[float, float, float, float] | None, str]:
    """Return a material's constant colour and opacity, or None and what is left out."""
    where = f"<{material.GetPath()}>"
    shader, _, _ = material.ComputeSurfaceSource()
    if not shader:
        return None, f"{where}: has no surface that a preview shows"
    kind = shader.GetShaderId()
    if kind != SURFACE:
        return None, f"{where}: is a {kind or 'shader'}, not a {SURFACE}"
    color, left_out = _constant(shader.GetInput("diffuseColor"))
    opacity, _ = _constant(shader.GetInput("opacity"))
    if color is None:
        return None, f"{where}: {left_out}" if left_out else ""
    red, green, blue = (max(float(each), 0.0) for each in color)
    return (red, green, blue, 1.0 if opacity is None else float(opacity)), ""


def _constant(given: UsdShade.Input | None) -> tuple[Any, str]:
    """Return an input's constant, or None and its connection."""
    if not given:
        return None, ""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(given):
        if UsdShade.Utils.GetType(attribute.GetName()) != UsdShade.AttributeType.Output:
            return attribute.Get(), ""
        return None, _connected(UsdShade.Shader(attribute.GetPrim()))
    return None, ""


def _connected(node: UsdShade.Shader) -> str:
    kind = node.GetShaderId()
    if kind == PRIMVAR:  # usually displayColor, which is drawn
        name = node.GetInput("varname")
        read = name.Get() if name else None
        return "" if str(read) == "displayColor" else f"its colour is primvar {read}"
    if kind == TEXTURE:
        file = node.GetInput("file")
        asset = file.Get() if file else None
        path = asset.path if isinstance(asset, Sdf.AssetPath) else ""
        return f"its colour is a texture{f', {path}' if path else ''}"
    return f"its colour is made by {kind or node.GetPath()}"
