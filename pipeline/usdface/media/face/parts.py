"""Classification of a head's pieces (skin, eye, tooth …) by name, or else by form.

Rigs are drawn without preparation. Many heads are one mesh without colours in which eyes, teeth and
lashes are separate pieces, which need their own shading.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import RigMesh
from usdface.media.face.mesh_topology import border_edges
from usdface.numerics.surface.surface_graph import connected_parts
from usdface.numerics.surface.triangulation import polygon_edges


class FacePart(IntEnum):
    """Part of the face, which determines shading."""

    SKIN = 0
    EYE = 1
    TEETH = 2
    MOUTH = 3
    HAIR = 4
    HIDDEN = 5


@dataclass(frozen=True)
class Eyeball:
    """The sphere fitted to an eye at rest."""

    center: FloatArray
    """(3,) [mm]"""
    radius: float
    """[mm]"""


@dataclass(frozen=True)
class Pieces:
    """The connected pieces of the visible meshes, classified."""

    of_point: IntArray
    """(points,): piece of each point, all meshes concatenated."""
    parts: IntArray
    """(pieces,): `FacePart` of each piece."""
    eyeballs: dict[int, Eyeball]
    """By piece."""


# Patterns of a prim's name; the first match is used.
_NAMES: tuple[tuple[str, FacePart], ...] = (
    (r"cornea|tear|wet|lacrimal|occlusion|eyeblend|eye_?shadow|lens", FacePart.HIDDEN),
    (r"lash|brow|hair|beard|mustache|moustache|stubble", FacePart.HAIR),
    (r"teeth|tooth|dent(al|ure)", FacePart.TEETH),
    (r"tongue|gum|mouth_?(bag|sock|cavity|interior)|oral", FacePart.MOUTH),
    (
        r"eye_?(l|r|left|right)?_?(ball|s)?\d*(_?(l|r|left|right|geo|mesh))*$"
        r"|(l|r|left|right)_?eye(?!lid|socket)|sclera|iris",
        FacePart.EYE,
    ),
)
_SPHERE_MISFIT = 0.06
"""Largest residual over the radius: 0.045 for eyeballs with a cornea, more for lashes."""
_EYE_SHEET = 2.7  # largest distance of lash cards from the eye's centre [radii]
_CLOSED_IN = 0.15  # visible share of the sky at rest below which a piece is in the mouth
_TOOTH_SIZE = 0.26  # largest diagonal of teeth over the head's width


def part_from_name(path: str) -> FacePart | None:
    """Return the part that a prim's name indicates, or None."""
    name = path.rsplit("/", 1)[-1].lower()
    for pattern, part in _NAMES:
        if re.search(pattern, name):
            return part
    return None


def find_pieces(meshes: Sequence[RigMesh], *, exposure: Callable[[], FloatArray]) -> Pieces:
    """Classify the pieces of a head at rest.

    `exposure`: returns the visible share of the sky at all points, (points,) [0-1]; called only if
    a piece without a name needs it.
    """
    labels, named = _label(meshes)
    points = np.concatenate([mesh.points for mesh in meshes])
    open_rim = np.concatenate(
        [np.isin(np.arange(len(mesh.points)), border_edges(mesh)) for mesh in meshes]
    )
    count = len(named)
    order = np.argsort(labels, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(labels, minlength=count))[:-1])
    parts = np.array([FacePart.SKIN if part is None else part for part in named], np.int64)
    unnamed = np.array([part is None for part in named])
    sizes = np.array([len(m) for m in members])
    width = _width(points)

    eyeballs = {
        piece: ball
        for piece in range(count)
        if (unnamed[piece] or parts[piece] == FacePart.EYE)
        and (ball := _fit_eyeball(points[members[piece]], width, certain=not unnamed[piece]))
        is not None
    }
    eyeballs = _in_pairs(eyeballs, certain=parts == FacePart.EYE)
    eyeballs, inner = _outermost(eyeballs)
    parts[list(eyeballs)] = FacePart.EYE
    parts[inner] = FacePart.HIDDEN

    largest = int(np.argmax(np.where(unnamed, sizes, 0)))
    for piece in np.flatnonzero(unnamed & (parts == FacePart.SKIN)):
        if piece == largest or sizes[piece] > 0.5 * sizes[largest]:
            continue
        cloud = points[members[piece]]
        # A tear line, shadow catcher or lash card, which production shaders make
        # transparent; drawn opaque, it would hide the lid.
        if bool(open_rim[members[piece]].any()) and any(
            np.linalg.norm(cloud - ball.center, axis=1).max() < _EYE_SHEET * ball.radius
            for ball in eyeballs.values()
        ):
            parts[piece] = FacePart.HIDDEN
        elif np.median(exposure()[members[piece]]) < _CLOSED_IN:
            small = np.linalg.norm(np.ptp(cloud, axis=0)) < _TOOTH_SIZE * width
            parts[piece] = FacePart.TEETH if small else FacePart.MOUTH
    return Pieces(of_point=labels, parts=parts, eyeballs=eyeballs)


def _label(meshes: Sequence[RigMesh]) -> tuple[IntArray, list[FacePart | None]]:
    """Return piece labels and parts by name; a mesh of a named part, except eyes, is one piece."""
    labels, named = [], list[FacePart | None]()
    for mesh in meshes:
        part = part_from_name(mesh.path)
        if part in (None, FacePart.EYE):
            edges = polygon_edges(mesh.face_counts, mesh.face_indices)
            own = connected_parts(edges, len(mesh.points))
        else:
            own = np.zeros(len(mesh.points), np.int64)
        labels.append(own + len(named))
        named.extend([part] * (int(own.max(initial=-1)) + 1))
    return np.concatenate(labels), named


def _width(points: FloatArray) -> float:
    low, high = np.percentile(points[:, 0], [2, 98])
    return float(max(high - low, 1e-9))


def _fit_eyeball(cloud: FloatArray, head_width: float, *, certain: bool) -> Eyeball | None:
    """Fit a sphere by least squares; None if the piece is not nearly spherical.

    Pieces named as eyes (`certain`) may have a flat back or a hollow iris: the fit is repeated
    without the quarter of the points with the largest residuals.
    """
    if len(cloud) < 20:
        return None
    kept = cloud
    center, radius = _fit_sphere(kept)
    if certain:
        away = np.abs(np.linalg.norm(cloud - center, axis=1) - radius)
        kept = cloud[away <= np.quantile(away, 0.75)]
        center, radius = _fit_sphere(kept)
    spread = np.std(np.linalg.norm(kept - center, axis=1))
    across = np.ptp(cloud, axis=0)[:2]
    fits = spread < _SPHERE_MISFIT * radius and np.all(across > 1.4 * radius)
    if not fits or not 0.02 * head_width < radius < 0.25 * head_width:
        return None
    return Eyeball(center=center, radius=radius)


def _fit_sphere(cloud: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of the least-squares sphere."""
    middle = cloud.mean(axis=0)
    local = cloud - middle
    system = np.column_stack([2 * local, np.ones(len(local))])
    solution = np.linalg.lstsq(system, np.sum(local**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))
    return middle + solution[:3], radius


def _in_pairs(balls: dict[int, Eyeball], *, certain: FloatArray) -> dict[int, Eyeball]:
    """Keep eyes with a partner of the same size; a single sphere is an ornament."""

    def has_partner(piece: int) -> bool:
        own = balls[piece]
        return any(
            abs(other.radius - own.radius) < 0.15 * own.radius
            and abs(other.center[0] - own.center[0]) > 2 * own.radius
            and np.abs(other.center - own.center)[1:].max() < own.radius
            for other in balls.values()
        )

    return {piece: ball for piece, ball in balls.items() if certain[piece] or has_partner(piece)}


def _outermost(balls: dict[int, Eyeball]) -> tuple[dict[int, Eyeball], list[int]]:
    """Split nested spheres (sclera in cornea) into the largest, which get an iris, and the rest."""
    inner = [
        piece
        for piece, ball in balls.items()
        if any(
            other.radius > ball.radius
            and np.linalg.norm(other.center - ball.center) < 0.5 * ball.radius
            for other in balls.values()
        )
    ]
    return {piece: ball for piece, ball in balls.items() if piece not in inner}, inner
