"""The built-in head of a style: skin, eyes, teeth, tongue, ears, brows, lashes and hair."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray, smoothstep
from usdface.demo import details
from usdface.demo.cage import lay_eye, lay_grid, lay_grid_faces, lay_mouth
from usdface.demo.half_cage import NO_RING, HalfCage, Mark, Whole, mirror_half, refine
from usdface.demo.sculpt import Form, Style, head_form, settle


def skin_colors(style: Style, points: FloatArray, marks: FloatArray) -> FloatArray:
    """Return linear colours of the skin, (points, 3), for points [mm] and their marks."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    eye, nose, mouth = style.eye, style.nose, style.mouth
    front = smoothstep(z, 20.0, 60.0)

    def spot(cx: float, cy: float, rx: float, ry: float) -> FloatArray:
        return front * np.exp(-(((x - cx) / rx) ** 2) - ((y - cy) / ry) ** 2)

    blush = 0.85 * spot(eye.center[0] + 8.0, eye.center[1] - 33.0, 19.0, 13.0)
    blush += 0.55 * spot(0.0, nose.tip[0], 13.0, 10.0) + 0.30 * spot(
        0.0, style.skull.chin[1], 14.0, 9.0
    )
    shadow = 0.30 * spot(
        eye.center[0], eye.center[1] + 3.0, eye.half_width * 1.25, eye.open_up + 8.0
    )
    color = np.array(style.palette.skin) * (1.0 - np.outer(blush, (0.02, 0.24, 0.24)))
    color *= 1.0 - np.outer(shadow, (0.35, 0.6, 0.55))

    ring, side = marks[:, Mark.MOUTH_RING], marks[:, Mark.MOUTH_SIDE]
    lip = np.array(style.palette.lip) * np.where(side > 0.0, 0.86, 1.04)[:, None]
    color = _mix(color, lip, smoothstep(ring, 2.30, 1.80))
    color = _mix(color, 0.55 * np.array(style.palette.lip), smoothstep(ring, 0.45, -0.1))
    color = _mix(color, np.array([0.30, 0.075, 0.065]), smoothstep(ring, -0.4, -1.6))
    color = _mix(color, np.array([0.045, 0.010, 0.009]), smoothstep(ring, -1.6, -3.2))
    corner = spot(mouth.half_width + 1.0, mouth.height + mouth.curve, 3.0, 1.6)
    color *= 1.0 - 0.45 * corner[:, None] * (ring > -0.5)[:, None]

    ring, side = marks[:, Mark.EYE_RING], marks[:, Mark.EYE_SIDE]
    color = _mix(color, 0.80 * np.array(style.palette.lip), 0.65 * smoothstep(ring, 0.15, -0.4))
    lash_line = (
        smoothstep(side, 0.0, 0.35) * smoothstep(ring, 0.42, 0.15) * smoothstep(ring, -1.5, -0.9)
    )
    color = _mix(color, 0.25 * np.array(style.palette.brow), lash_line)
    color = _mix(
        color,
        np.array([0.10, 0.04, 0.03]),
        0.45 * smoothstep(side, 0.0, -0.4) * smoothstep(np.abs(ring), 0.35, 0.1),
    )
    crease = np.exp(-(((ring - 2.1) / 0.35) ** 2)) * smoothstep(side, 0.1, 0.6)
    color *= 1.0 - np.outer(crease, (0.18, 0.28, 0.28))
    return _mix(
        color, np.array([0.03, 0.008, 0.006]), smoothstep(marks[:, Mark.NOSTRIL], 0.02, 0.45)
    )


def _mix(color: FloatArray, other: FloatArray, amount: FloatArray) -> FloatArray:
    return color + amount[:, None] * (other - color)


class HeadPart(IntEnum):
    """Pieces of the head."""

    SKIN = 0
    EARS = 1
    EYES = 2
    UPPER_TEETH = 3
    LOWER_TEETH = 4
    TONGUE = 5
    BROWS = 6
    LASHES = 7
    HAIR = 8


@dataclass(frozen=True)
class DemoHead:
    """All pieces of a head, concatenated, with shapes."""

    style: Style
    points: FloatArray
    """(points, 3) [mm]"""
    faces: IntArray
    """(faces, 4)"""
    parts: IntArray
    """(points,): `HeadPart` of each point."""
    marks: FloatArray
    """(points, len(Mark)): see `Mark`."""
    colors: FloatArray
    """(points, 3): linear."""
    mirror: IntArray
    """(points,): index of each point's mirror image; itself for hair, which is not symmetric."""
    anchors: IntArray
    """(points,): the point that each one follows: the edge of the lid for lashes, else itself."""
    shapes: Mapping[str, tuple[tuple[float, FloatArray], ...]] = field(default_factory=dict)
    """Keys of each shape, ascending to weight 1: (weight, offsets [mm])."""


def bare_head(style: Style) -> DemoHead:
    """Build the head of a style at rest, without shapes."""
    form = head_form(style)
    skin = _skin(style, form)
    rim = lid_edge(skin.points, skin.marks, upper=True)
    lip = lip_rim(skin.points, skin.marks, upper=True)
    front = float(skin.points[lip[len(lip) // 2], 2]) - 5.0
    halves = {
        HeadPart.EARS: details.ear(style, form),
        HeadPart.EYES: details.eyeball(style),
        HeadPart.UPPER_TEETH: details.teeth(style, front=front, upper=True),
        HeadPart.LOWER_TEETH: details.teeth(style, front=front, upper=False),
        HeadPart.TONGUE: details.tongue(style, front=front),
        HeadPart.BROWS: details.brow(style, form),
        HeadPart.LASHES: details.lashes(style, skin.points[rim]),
    }
    head = skin
    for part, half in halves.items():
        whole = mirror_half(half.points, half.faces)
        head = _with_piece(head, part, whole, half.colors[whole.source])
    hair = details.hair_cap(style, form)
    own = np.arange(len(hair.points))
    head = _with_piece(head, HeadPart.HAIR, Whole(hair.points, hair.faces, own, own), hair.colors)
    lash = np.flatnonzero(head.parts == HeadPart.LASHES)
    rows = len(lash) // 2 // len(rim)
    left = np.tile(rim, rows)
    anchors = head.anchors.copy()
    anchors[lash] = np.concatenate([left, head.mirror[left]])
    return replace(head, anchors=anchors)


def _skin(style: Style, form: Form) -> DemoHead:
    """Return the skin: the subdivided cage, projected to the sculpted form and coloured."""
    cage, cage_marks = build_cage(style, form)
    matrix, faces, mirror = refine(cage.faces, cage.mirror)
    points, marks = matrix @ cage.points, matrix @ cage_marks
    amount = np.clip(1.3 * marks[:, Mark.SETTLE] - 0.15, 0.0, 1.0)
    smooth = _neighbour_mean(faces, len(points))
    points = settle(form, points, amount)
    for _ in range(6):  # spreads points that accumulate at sharp folds
        points += 0.6 * amount[:, None] * (smooth @ points - points)
    points = settle(form, points, 0.8 * amount)
    points = _close_lips(style, points, marks)
    points = _clear_eyeball(style, points, marks)
    points = 0.5 * (points + points[mirror] * (-1.0, 1.0, 1.0))
    return DemoHead(
        style=style,
        points=points,
        faces=faces,
        parts=np.full(len(points), int(HeadPart.SKIN)),
        marks=marks,
        colors=skin_colors(style, points, marks),
        mirror=mirror,
        anchors=np.arange(len(points)),
    )


def _neighbour_mean(faces: IntArray, count: int) -> sparse.csr_array:
    """Return the matrix of the mean over each point's neighbours."""
    ends = np.concatenate([faces, np.roll(faces, 1, axis=1)], axis=1).ravel()
    others = np.concatenate([np.roll(faces, 1, axis=1), faces], axis=1).ravel()
    adjacency = sparse.csr_array((np.ones(len(ends)), (ends, others)), shape=(count, count))
    return sparse.csr_array(sparse.diags_array(1.0 / adjacency.sum(axis=1)) @ adjacency)


def lip_rim(points: FloatArray, marks: FloatArray, *, upper: bool) -> IntArray:
    """Return indices of a lip's points that touch the other lip, from right to left corner."""
    side = marks[:, Mark.MOUTH_SIDE]
    on_rim = np.abs(marks[:, Mark.MOUTH_RING]) < 1e-6
    found = np.flatnonzero(on_rim & ((side > 1e-6) if upper else (side < -1e-6)))
    return found[np.argsort(points[found, 0])]


def _close_lips(style: Style, points: FloatArray, marks: FloatArray) -> FloatArray:
    """Close the lips, whose rims subdivision has separated."""
    upper, lower = lip_rim(points, marks, upper=True), lip_rim(points, marks, upper=False)
    x = points[:, 0]
    top, bottom = (np.interp(x, points[r, 0], points[r, 1]) for r in (upper, lower))
    top_z, bottom_z = (np.interp(x, points[r, 0], points[r, 2]) for r in (upper, lower))
    ring, side = marks[:, Mark.MOUTH_RING], marks[:, Mark.MOUTH_SIDE]
    near = smoothstep(np.abs(ring), 2.2, 0.0) * (np.abs(x) < style.mouth.half_width)
    half_gap = 0.5 * (top - bottom) - 0.06
    moved = points.copy()
    moved[:, 1] -= near * np.sign(side) * half_gap
    moved[:, 2] -= near * np.sign(side) * 0.5 * (top_z - bottom_z)
    return moved


def _clear_eyeball(style: Style, points: FloatArray, marks: FloatArray) -> FloatArray:
    """Move points of the lids that are too close to the eyeball outwards."""
    center = np.array(style.eye.center)
    ring = marks[:, Mark.EYE_RING]
    to_left = np.ones_like(points)
    to_left[points[:, 0] < 0.0, 0] = -1.0
    offset = points * to_left - center
    length = np.linalg.norm(offset, axis=1)
    least = style.eye.radius + np.interp(
        ring, [-3.0, -1.0, 0.0, 1.0, 2.0], [0.8, 0.8, 1.9, 2.2, 1.5]
    )
    push = np.where(ring < 2.5, np.maximum(least / np.maximum(length, 1e-6), 1.0), 1.0)
    return np.asarray(points + (push - 1.0)[:, None] * offset * to_left)


def lid_edge(points: FloatArray, marks: FloatArray, *, upper: bool) -> IntArray:
    """Return indices of the edge of a left lid with both corners, the inner one first."""
    ring, side = marks[:, Mark.EYE_RING], marks[:, Mark.EYE_SIDE]
    on_lid = (side > -1e-6) if upper else (side < 1e-6)
    found = np.flatnonzero((np.abs(ring) < 1e-6) & on_lid & (points[:, 0] > 0.0))
    return found[np.argsort(points[found, 0])]


def _with_piece(head: DemoHead, part: HeadPart, whole: Whole, colors: FloatArray) -> DemoHead:
    count, first = len(whole.points), len(head.points)
    marks = np.zeros((count, len(Mark)))
    marks[:, [Mark.MOUTH_RING, Mark.EYE_RING]] = NO_RING
    return replace(
        head,
        points=np.concatenate([head.points, whole.points]),
        faces=np.concatenate([head.faces, whole.faces + first]),
        parts=np.concatenate([head.parts, np.full(count, int(part))]),
        marks=np.concatenate([head.marks, marks]),
        colors=np.concatenate([head.colors, colors]),
        mirror=np.concatenate([head.mirror, whole.mirror + first]),
        anchors=np.concatenate([head.anchors, first + np.arange(count)]),
    )


def build_cage(style: Style, form: Form) -> tuple[Whole, FloatArray]:
    """Return the control cage of the skin, and the marks of its points, (points, len(Mark)).

    A grid of rows (neck to crown) and columns (midline to nape) with rings around the eye and the
    mouth in place of two blocks, so that lids and lips open along loops. The marks of the rings are
    used by the shapes.
    """
    half = HalfCage()
    grid = lay_grid(half, style, form)
    lay_grid_faces(half, grid)
    lay_mouth(half, style, form, grid)
    lay_eye(half, style, grid)
    whole = mirror_half(np.array(half.points), np.array(half.faces))
    return whole, np.array(half.marks)[whole.source]
