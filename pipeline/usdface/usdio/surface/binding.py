"""Marker bindings as layers, with proposals and corrections.

The layer to open has the mesh and a sphere for every marker. Of its two sublayers the stronger has
corrections, which are preserved when markers are bound again; the weaker has the proposal. A marker
is corrected by moving its sphere, by another face, other weights on the face or the index of a
point, or by deactivating its prim, which leaves the marker out.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, Vt

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import corrected_path, proposed_path
from usdface.core.text import first_few
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.numerics.surface.surface_places import (
    SurfacePoints,
    nearest_places,
    place_on_polygon,
    places_at_points,
    polygon_weights,
)
from usdface.usdio.authoring import (
    apply_api,
    author_uniform,
    define_prim,
    define_reference_prim,
    top_path,
    unique_names,
    value_of,
)
from usdface.usdio.layers import (
    new_layer,
    new_layers,
    open_layer,
    open_stage,
    refusing_wrong_types,
    relative_path,
)
from usdface.usdio.rig.mesh import BoundSurface
from usdface.usdio.units import MM_PER_STAGE_UNIT, author_units, row_matrix, stage_to_ours

_ROOT = Sdf.Path("/Binding")
_MARKERS = _ROOT.AppendChild("Markers")
MESH = _ROOT.AppendChild("Mesh")
BALL_RADIUS = 0.15
"""That of a marker [cm]."""

TRANSLATE = "xformOp:translate"
_AUTHOR = "face:binding:author"
HOW_TO_CORRECT = """Corrections of a marker binding: binding again keeps this layer, and the tuning
page adds to it. Write an over of the marker, with one of: xformOp:translate (move its ball),
face:binding:point (index of a point of the mesh), face:binding:face with or without
face:binding:weights (one weight per corner of that face), or `active = false` to leave the marker
out."""


@dataclass(frozen=True)
class ReadBinding:
    """A binding with corrections."""

    binding: MarkerBinding
    """Sources are ``'corrected'`` if a stronger layer has an opinion."""
    left_out: tuple[str, ...]
    """Markers whose prim is inactive."""
    authors: dict[str, str]
    """Author of the correction of a marker, if known."""


def write_binding(
    path: Path,
    binding: MarkerBinding,
    face: BoundSurface,
    *,
    provenance: Provenance,
    author: Callable[[Sdf.PrimSpec], None] | None = None,
) -> None:
    """Write a binding with its proposal, and preserve corrections.

    `author`: authors attributes of the root prim of the proposal.
    """
    stage = open_stage(face.file)
    proposal, corrections = proposed_path(path), corrected_path(path)
    written: dict[Path, Provenance | None] = {proposal: provenance, path: provenance}
    if has_corrections(path) or not corrections.is_file():
        written = {corrections: None, **written}
    with new_layers(written) as layers:
        *corrected, proposed, layer = layers
        for each in corrected:
            _author_corrections(each, corrections, path)
        _author_proposed(proposed, binding, face)
        if author is not None:
            author(proposed.GetPrimAtPath(_ROOT))
        author_units(layer)
        layer.defaultPrim = _ROOT.name
        layer.subLayerPaths = [relative_path(each, path) for each in (corrections, proposal)]
        root = define_prim(layer, _ROOT, "Xform")
        root.SetInfo("kind", Kind.Tokens.assembly)  # rigs are models, which need a group above
        apply_api(root, "FaceBindingAPI")
        asset = Sdf.AssetPath(relative_path(face.file, path))
        author_uniform(root, "face:binding:mesh", Sdf.ValueTypeNames.Asset, asset)
        author_uniform(root, "face:binding:prim", Sdf.ValueTypeNames.String, face.path)
        author_uniform(root, "face:binding:hash", Sdf.ValueTypeNames.String, face.hash)
        _show_mesh(layer, face, stage, path)


@refusing_wrong_types
def read_binding(path: Path, face: BoundSurface) -> ReadBinding:
    """Read a binding with corrections; `face` must be its surface."""
    stage = open_stage(path)
    if read_surface_hash(path) != face.hash:
        raise InputError(
            f"{path}: was made on another surface than {face.file} <{face.path}>, whose points, in "
            "millimetres, or faces differ; bind again, under another name if its corrections are "
            "to be kept"
        )
    names, read, left_out, authors = [], [], [], {}
    for name, prim in _named_markers(stage):
        if not prim.IsActive():
            left_out.append(name)
            continue
        names.append(name)
        read.append(_read_place(path, prim, face))
        author = str(_value(prim, _AUTHOR) or "")
        if author and read[-1][-1] == "corrected":
            authors[name] = author
    if not read:
        raise InputError(f"{path} <{_MARKERS}>: binds no marker; bind again")
    places, confidence, distance_mm, sources = zip(*read, strict=True)
    binding = MarkerBinding(
        names=tuple(names),
        places=SurfacePoints.join(places),
        confidence=np.array(confidence),
        distance_mm=np.array(distance_mm),
        sources=sources,
    )
    return ReadBinding(binding, tuple(left_out), authors)


def _author_corrections(layer: Sdf.Layer, corrections: Path, path: Path) -> None:
    """Write corrections: those there are, below those that a DCC saved in the layer to open."""
    author_units(layer)
    layer.defaultPrim = _ROOT.name
    layer.comment = HOW_TO_CORRECT
    Sdf.CreatePrimInLayer(layer, _MARKERS)
    if corrections.is_file():
        layer.TransferContent(open_layer(corrections))
    if has_corrections(path):
        opened = open_layer(path)
        for marker in opened.GetPrimAtPath(_MARKERS).nameChildren:
            over = Sdf.CreatePrimInLayer(layer, marker.path)
            if marker.HasActive():
                over.active = marker.active
            for each in marker.properties:
                Sdf.CopySpec(opened, each.path, layer, each.path)


def _author_proposed(layer: Sdf.Layer, binding: MarkerBinding, face: BoundSurface) -> None:
    mesh = face.mesh
    at = binding.places.positions(mesh.points) / MM_PER_STAGE_UNIT
    shares = polygon_weights(binding.places, mesh.face_counts, mesh.face_indices)
    kinds = Sdf.ValueTypeNames
    author_units(layer)
    layer.defaultPrim = _ROOT.name
    define_prim(layer, _ROOT, "Xform")
    define_prim(layer, _MARKERS, "Scope")
    valid = unique_names(
        name if Sdf.Path.IsValidIdentifier(name) else str(Tf.MakeValidIdentifier(name))
        for name in binding.names
    )
    for index, (name, unique) in enumerate(zip(binding.names, valid, strict=True)):
        prim = define_prim(layer, _MARKERS.AppendChild(unique), "Sphere")
        apply_api(prim, "FaceMarkerBindingAPI")
        confidence = float(binding.confidence[index])
        weights = Vt.FloatArray(shares[index].tolist())
        for key, kind, value in (
            ("face:binding:marker", kinds.Token, name),
            ("face:binding:face", kinds.Int, int(binding.places.faces[index])),
            ("face:binding:weights", kinds.FloatArray, weights),
            ("face:binding:confidence", kinds.Float, round(confidence, 4)),
            ("face:binding:distance", kinds.Float, round(float(binding.distance_mm[index]), 3)),
            ("face:binding:source", kinds.Token, binding.sources[index]),
            ("xformOpOrder", kinds.TokenArray, Vt.TokenArray([TRANSLATE])),
        ):
            author_uniform(prim, key, kind, value)
        place = Gf.Vec3d(*(round(float(c), 6) for c in at[index]))
        Sdf.AttributeSpec(prim, TRANSLATE, kinds.Double3).default = place
        Sdf.AttributeSpec(prim, "radius", kinds.Double).default = BALL_RADIUS
        extent = [Gf.Vec3f(-BALL_RADIUS), Gf.Vec3f(BALL_RADIUS)]
        Sdf.AttributeSpec(prim, "extent", kinds.Float3Array).default = extent
        color = [Gf.Vec3f(0.9 - 0.8 * confidence, 0.15 + 0.6 * confidence, 0.1)]
        Sdf.AttributeSpec(prim, "primvars:displayColor", kinds.Color3fArray).default = color


def _show_mesh(layer: Sdf.Layer, face: BoundSurface, stage: Usd.Stage, path: Path) -> None:
    """Add a reference to the mesh, rotated and scaled to the units of the spheres."""
    holder = define_prim(layer, MESH, "Xform")
    holder.SetInfo("kind", Kind.Tokens.group)
    matrix = Sdf.AttributeSpec(holder, "xformOp:transform", Sdf.ValueTypeNames.Matrix4d)
    matrix.default = row_matrix(stage_to_ours(stage) / MM_PER_STAGE_UNIT)
    order = Vt.TokenArray(["xformOp:transform"])
    author_uniform(holder, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, order)
    asset = relative_path(face.file, path)
    define_reference_prim(layer, MESH.AppendChild("Asset"), asset, top_path(face.path))


def _read_place(
    path: Path, prim: Usd.Prim, face: BoundSurface
) -> tuple[SurfacePoints, float, float, str]:
    """Return a marker's place, its confidence, its distance [mm] and its source."""
    mesh = face.mesh
    counts, indices = mesh.face_counts, mesh.face_indices
    point = _value(prim, "face:binding:point")
    face_corrected, weights_corrected, ball_moved = (
        _corrected(prim, key) for key in ("face:binding:face", "face:binding:weights", TRANSLATE)
    )
    source = str(_value(prim, "face:binding:source") or "proposed")
    if source == "corrected":  # by a correction that has been removed
        source = "proposed"
    is_corrected = point is not None or face_corrected or weights_corrected or ball_moved
    try:
        if point is not None:
            places = places_at_points(counts, indices, np.array([int(str(point))]))
        elif ball_moved and not (face_corrected or weights_corrected):
            places = _under_ball(prim, face)
        else:
            number = int(str(_value(prim, "face:binding:face")))
            weights = np.array(_value(prim, "face:binding:weights"), np.float64).reshape(-1)
            if face_corrected and not weights_corrected:
                known = 0 <= number < len(counts)
                corners = int(counts[number]) if known else 3
                weights = np.full(corners, 1 / corners)  # by default the centre of the face
            places = place_on_polygon(mesh.points, counts, indices, face=number, weights=weights)
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{path} <{prim.GetPath()}>: marker {prim.GetName()} is not on the mesh: {error}; "
            "correct its ball, point, or face and weights, or deactivate it"
        ) from error
    if is_corrected:
        return places, 1.0, 0.0, "corrected"
    confidence, distance = (
        float(str(_value(prim, f"face:binding:{key}") or 0)) for key in ("confidence", "distance")
    )
    return places, confidence, distance, source


def _under_ball(prim: Usd.Prim, face: BoundSurface) -> SurfacePoints:
    """Return the place nearest to a marker's sphere, which must be near the mesh."""
    mesh, ball = face.mesh, np.array(prim.GetAttribute(TRANSLATE).Get(), np.float64)
    if not np.isfinite(ball).all():
        raise ValueError(f"its ball is at {ball.tolist()}")
    at = ball[None] @ stage_to_ours(prim.GetStage()).T
    places = nearest_places(mesh.points, mesh.face_counts, mesh.face_indices, at)
    away = float(np.linalg.norm(places.positions(mesh.points) - at))
    if away > face.reach_mm:
        raise ValueError(f"its ball is {away:.0f} mm off it")
    return places


def _corrected(prim: Usd.Prim, name: str) -> bool:
    """Whether a layer stronger than the proposal has a value of an attribute."""
    attribute = prim.GetAttribute(name)
    stack = attribute.GetPropertyStack() if attribute else []
    return any(spec.HasDefaultValue() for spec in stack[:-1])


def _value(prim: Usd.Prim, name: str) -> object:
    """Return an attribute's value; of an inactive prim, the strongest opinion."""
    if prim.IsActive():
        return value_of(prim, name)
    specs = (spec.properties[name] for spec in prim.GetPrimStack() if name in spec.properties)
    return next((spec.default for spec in specs if spec.default is not None), None)


def has_binding(path: Path) -> bool:
    """Whether a file exists and is a binding; refuse corrections of one that is gone."""
    if not path.is_file():
        if has_corrections(corrections := corrected_path(path)):
            raise InputError(
                f"{corrections}: corrects markers of {path.name}, which is gone, so that its "
                f"surface is unknown; put {path.name} back, or remove the corrections"
            )
        return False
    layer = open_layer(path)  # keep a reference: specs do not outlive their layer
    spec = layer.GetPrimAtPath(_ROOT)
    return spec is not None and "face:binding:hash" in spec.properties


def has_corrections(corrections: Path) -> bool:
    """Whether a layer exists and corrects a marker."""
    if not corrections.is_file():
        return False
    layer = open_layer(corrections)
    markers = layer.GetPrimAtPath(_MARKERS)
    return markers is not None and bool(markers.nameChildren)


def correct_binding(
    path: Path,
    places: Mapping[str, FloatArray | None],
    made: Provenance,
    *,
    author: str = "",
) -> None:
    """Write corrections of markers to the corrected layer.

    Parameters
    ----------
    places : mapping of str to (3,) float array or None
        New position of each marker's sphere [mm]; None removes its correction.
    author : str
        Stored with each correction; empty if unknown.
    """
    stage = open_stage(path)
    prims = {name: prim.GetPath() for name, prim in _named_markers(stage)}
    unknown = [name for name in places if name not in prims]
    if unknown:
        raise InputError(f"{path}: binds no marker {unknown[0]!r}; it has {first_few(prims)}")
    corrections, opened = corrected_path(path), open_layer(path)
    if hidden := [name for name in places if opened.GetPrimAtPath(prims[name]) is not None]:
        raise InputError(
            f"{path}: moves {first_few(hidden)} itself, which would hide another correction; place "
            f"or select again, which brings it to {corrections.name}"
        )
    old = open_layer(corrections)
    with new_layer(corrections, made) as layer:
        layer.TransferContent(old)
        for name, at in places.items():
            holder = layer.GetPrimAtPath(_MARKERS)
            over = layer.GetPrimAtPath(prims[name])
            if over is not None and holder is not None:
                del holder.nameChildren[over.name]
            if at is not None:
                over = Sdf.CreatePrimInLayer(layer, prims[name])
                ball = Sdf.AttributeSpec(over, TRANSLATE, Sdf.ValueTypeNames.Double3)
                ball.default = Gf.Vec3d(*(round(float(c) / MM_PER_STAGE_UNIT, 6) for c in at))
                if author:
                    author_uniform(over, _AUTHOR, Sdf.ValueTypeNames.Token, author)


def _named_markers(stage: Usd.Stage) -> Iterator[tuple[str, Usd.Prim]]:
    """Yield the name and the prim of each marker, those of inactive ones too."""
    holder = stage.GetPrimAtPath(_MARKERS)
    for prim in holder.GetAllChildren() if holder else ():
        yield str(_value(prim, "face:binding:marker") or prim.GetName()), prim


def read_surface_hash(path: Path) -> str:
    """Return the hash of a binding's surface."""
    stage = open_stage(path)
    root = stage.GetDefaultPrim()
    if not root or not root.HasAPI("FaceBindingAPI"):
        raise InputError(
            f"{path}: not a binding: its default prim has no FaceBindingAPI; make one with "
            "`usdface place` or `usdface bind`"
        )
    return str(root.GetAttribute("face:binding:hash").Get() or "")
