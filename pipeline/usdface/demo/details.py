"""Pieces of the head other than skin: eyeballs, teeth, tongue, ears, brows, lashes (left), hair."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from usdface.core.arrays import FloatArray, IntArray, smoothstep
from usdface.demo.half_cage import grid_faces
from usdface.demo.sculpt import Form, Style, trace


@dataclass(frozen=True)
class Piece:
    """One piece of the head, or its left half."""

    points: FloatArray
    """(points, 3) [mm]"""
    faces: IntArray
    """(faces, 4)"""
    colors: FloatArray
    """(points, 3): linear."""


def eyeball(style: Style) -> Piece:
    """Build an eyeball of rings around the gaze, denser where the colour changes."""
    eye, iris = style.eye, np.array(style.palette.iris)
    border = np.arcsin(eye.iris)
    pupil = 0.46 * border
    angles = np.concatenate(
        [
            [0.002, 0.7 * pupil, pupil, pupil + 0.025],
            np.linspace(pupil + 0.07, border - 0.06, 4),
            [border - 0.03, border + 0.015],
            np.linspace(border + 0.12, 2.5, 9),
        ]
    )
    turns = np.arange(32) * 2.0 * np.pi / 32
    along = (angles - pupil) / (border - pupil)
    light = np.interp(along, [0.0, 0.25, 0.75, 0.93, 1.0], [0.50, 0.9, 1.15, 0.75, 0.18])
    ring = light[:, None, None] * iris * (1.0 + 0.9 * smoothstep(np.sin(turns), 0.6, -1.0))[:, None]
    ring = ring * (1.0 + 0.10 * np.cos(11.0 * turns) + 0.06 * np.sin(5.0 * turns + 1.0))[:, None]
    white = np.array([0.80, 0.775, 0.755]) - np.outer(
        smoothstep(angles, 0.55, 1.3), [0.10, 0.20, 0.20]
    )
    colors = np.where((angles < pupil + 0.01)[:, None, None], 0.004, ring)
    colors = np.where((angles > border)[:, None, None], white[:, None], colors)
    points = np.stack(
        [
            np.outer(np.sin(angles), np.cos(turns)),
            np.outer(np.sin(angles), np.sin(turns)),
            np.outer(np.cos(angles), np.ones(32)),
        ],
        axis=-1,
    )
    return Piece(
        points=points.reshape(-1, 3) * eye.radius + eye.center,
        faces=grid_faces(len(angles), 32, closed=True, flip=True),
        colors=colors.reshape(-1, 3),
    )


_TOOTH_WIDTHS = {True: (8.6, 6.6, 7.4, 6.8, 6.6, 9.5), False: (5.4, 5.8, 6.6, 6.8, 6.8, 10.0)}
_TOOTH_HEIGHTS = {True: (9.6, 8.6, 9.4, 8.2, 7.6, 7.0), False: (8.6, 8.6, 9.0, 8.0, 7.4, 7.0)}


def teeth(style: Style, *, front: float, upper: bool) -> Piece:
    """Build one dental arch with teeth and gum. `front`: z of the front teeth [mm]."""
    widths = 0.92 * np.array(_TOOTH_WIDTHS[upper])
    samples = np.array([0.0, 0.12, 0.35, 0.65, 0.88])
    starts = np.concatenate([[0.0], np.cumsum(widths)])
    along = np.concatenate([s + samples * w for s, w in zip(starts, widths, strict=False)])
    inside = np.tile(samples, len(widths))
    height = np.repeat(_TOOTH_HEIGHTS[upper], len(samples))
    swell = np.sin(np.pi * inside) ** 0.45
    tight = 0.0 if upper else 2.2
    # The arch is a half ellipse, sampled by arc length.
    fine = np.linspace(0.0, 0.5 * np.pi, 400)
    arch = np.stack([(25.0 - tight) * np.sin(fine), (36.0 - tight) * (np.cos(fine) - 1.0)], axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(arch, axis=0), axis=1))])
    x = np.interp(along, length, arch[:, 0])
    z = np.interp(along, length, arch[:, 1])
    direction = np.stack([x / 25.0**2, (z + 36.0) / 36.0**2], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sign = 1.0 if upper else -1.0
    edge = style.mouth.height + (-2.8 if upper else -2.2)
    rows = (  # share of the tooth's height from its edge, offset out of the arch, depth of gaps
        (1.9, -2.5, 0.0),
        (1.35, 0.4, 0.25),
        (1.02, 0.3, 0.9),
        (0.55, 0.55, 1.0),
        (0.12, 0.05, 1.0),
        (0.0, -0.6, 1.0),
        (0.06, -2.6, 0.3),
        (1.0, -4.5, 0.0),
    )
    points, colors = [], []
    gum, enamel = np.array([0.45, 0.14, 0.135]), np.array([0.84, 0.80, 0.71])
    for part, out, parted in rows:
        push = out - 0.9 * parted * (1.0 - swell)
        lift = part * height + 0.9 * (1.0 - swell) * (part < 0.1)
        row = np.column_stack([x, sign * lift, z]) + np.column_stack(
            [push * direction[:, 0], 0.0 * x, push * direction[:, 1]]
        )
        place = np.array([0.0, edge, front - (0.0 if upper else 2.6)])
        points.append(row + place)
        shade = 0.45 + 0.55 * smoothstep(swell, 0.0, 0.6) if parted > 0.5 else 1.0 + 0.0 * swell
        colors.append(
            np.outer(shade, gum if part > 1.01 else enamel) * (0.5 if out < -2.0 else 1.0)
        )
    stacked = np.concatenate(points)
    stacked[np.tile(np.arange(len(x)) == 0, len(rows)), 0] = 0.0
    return Piece(stacked, grid_faces(len(rows), len(x), flip=upper), np.concatenate(colors))


def tongue(style: Style, *, front: float) -> Piece:
    """Build a flattened half ellipsoid with a groove along its middle."""
    across, along = np.meshgrid(
        np.linspace(0.0, np.pi, 9), np.linspace(0.03, 0.5 * np.pi, 10), indexing="ij"
    )
    width = np.sin(along) ** 0.75
    x = 16.0 * width * np.sin(0.5 * across)
    y = 5.0 * np.cos(0.5 * across) * width - 1.4 * np.exp(-((x / 3.0) ** 2)) * width
    under = across > 0.75 * np.pi
    y = np.where(under, -4.0 * width, y)
    z = 34.0 * (np.cos(along) - 1.0)
    points = np.stack([x, y + style.mouth.height - 9.5, z + front - 8.0], axis=-1)
    points[0, :, 0] = 0.0
    colors = np.array([0.50, 0.165, 0.155]) * (1.0 - 0.35 * np.exp(-((x / 2.5) ** 2)))[..., None]
    return Piece(points.reshape(-1, 3), grid_faces(9, 10, flip=True), colors.reshape(-1, 3))


def ear(style: Style, form: Form) -> Piece:
    """Build an ear as a shell of rings: concha, antihelix, helix and back."""
    reach = np.array(
        [0.03, 0.25, 0.40, 0.50, 0.58, 0.66, 0.74, 0.82, 0.90, 0.97, 1.0, 0.97, 0.84, 0.6]
    )
    rise = np.array([-3.0, -3.2, -2.2, 0.2, 2.4, 3.0, 2.0, 1.2, 2.8, 4.4, 3.0, 0.2, -3.0, -8.0])
    turns = np.arange(28) * 2.0 * np.pi / 28
    s, c = np.sin(turns), np.cos(turns)
    lobe, front, top = (
        smoothstep(s, -0.35, -0.95),
        smoothstep(c, 0.1, 0.9),
        smoothstep(s, 0.2, 1.0),
    )
    depth = (15.0 + 2.2 * s - 3.0 * lobe) * c - 1.5 * front
    height = 27.0 * s + 2.0 * c
    u, v = np.outer(reach, depth), np.outer(reach, height)
    w = rise[:, None] * (1.0 - 0.55 * lobe) * (1.0 - 0.55 * front * (reach > 0.45)[:, None])
    w = w + np.maximum(-u, 0.0) * 0.45 + 1.0 * top * reach[:, None]
    # The tragus: a small flap over the canal, from the front.
    w = w + 4.0 * np.exp(-(((u - 8.0) / 3.5) ** 2) - ((v + 3.0) / 5.0) ** 2)
    middle = np.array([0.0, style.eye.center[1] - 17.0, -13.0])
    start = middle * (0.0, 1.0, 1.0) + (200.0, 0.0, 0.0)
    side = trace(form, start[None], np.array([[-1.0, 0.0, 0.0]]))[0, 0]
    lean = np.radians(10.0)
    back, up = u * np.cos(lean) + v * np.sin(lean) * -1.0, v * np.cos(lean) + u * np.sin(lean)
    points = np.stack([side - 0.5 + w, middle[1] + up, middle[2] + back], axis=-1)
    skin = np.array(style.palette.skin)
    dark = np.interp(reach, [0.0, 0.35, 0.6, 0.8, 0.97], [0.42, 0.62, 0.95, 0.75, 1.0])
    colors = dark[:, None] * skin * (1.0, 0.90, 0.88)
    return Piece(
        points.reshape(-1, 3),
        grid_faces(len(reach), 28, closed=True),
        np.repeat(colors, 28, axis=0),
    )


def brow(style: Style, form: Form) -> Piece:
    """Build a brow as a tapering pad above the eye."""
    e, s = style.eye, style.skull
    rows, columns = 33, 9
    along, across = np.linspace(0.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)[None]
    half = 3.1 * np.minimum(1.0, np.sqrt(0.02 + along / 0.22)) * (1.0 - 0.82 * along**1.8)
    x = e.center[0] - e.half_width * 0.98 + e.half_width * 2.3 * along
    x = x - 1.6 * across * (1.0 - along)  # the inner end is slanted
    arch = 8.0 * np.sin(np.pi * np.minimum(0.02 + 0.80 * along, 1.0)) ** 1.1
    y = e.center[1] + s.brow_height + 0.5 + arch - 7.0 * along**2 + half * across
    flat = np.stack([x, y, np.full_like(x, 200.0)], axis=-1).reshape(-1, 3)
    on_skin = trace(form, flat, np.tile((0.0, 0.0, -1.0), (len(flat), 1)))
    pad = 1.3 * np.sqrt(np.maximum(1.0 - across**2, 0.0)) * (1.0 - 0.5 * along) - 0.5
    points = on_skin + np.stack([0 * pad, 0.15 * pad, pad], axis=-1).reshape(-1, 3)
    shade = 1.0 + 0.15 * np.cos(np.arange(rows * columns) * 1.7)
    return Piece(points, grid_faces(rows, columns, flip=True), np.outer(shade, style.palette.brow))


def lashes(style: Style, rim: FloatArray) -> Piece:
    """Build lashes on the edge of the upper lid, longest towards the outer corner.

    `rim`: (points, 3), the lid's edge from the inner to the outer corner.
    """
    center = np.array(style.eye.center)
    across = (rim[:, 0] - center[0]) / style.eye.half_width
    length = (0.7 + 2.3 * smoothstep(across, -0.9, 0.7)) * smoothstep(across, -1.05, -0.7)
    length = length * smoothstep(across, 1.0, 0.72) + 0.25
    out = rim - center
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    rows = []
    for part, curl in ((-0.25, -0.1), (0.15, 0.05), (0.6, 0.22), (1.0, 0.55)):
        lift = np.column_stack([0.35 * across * part, np.full(len(rim), curl), 0.0 * across])
        rows.append(rim + (part * length)[:, None] * out + length[:, None] * lift)
    points = np.concatenate(rows)
    return Piece(
        points,
        grid_faces(4, len(rim)),
        np.tile(0.35 * np.array(style.palette.brow), (len(points), 1)),
    )


# The hairline: azimuth from the front [degrees], height above the eyes [mm].
_LINE_ANGLE = (0, 12, 24, 34, 44, 54, 63, 70, 75, 79, 84, 90, 97, 104, 110, 116, 126, 142, 160, 180)
_LINE_HEIGHT = (62, 63, 65, 66, 60, 47, 30, 9, -8, -10, -4, 8, 13, 11, 1, -16, -36, -54, -65, -67)
_COLUMNS, _ROWS = 120, 32
_PARTING_X = 20.0
"""x of the parting over the forehead [mm]."""


def hair_cap(style: Style, form: Form) -> Piece:
    """Build the hair of a style on its head. `form`: signed distance to the head [mm]."""
    azimuth = np.linspace(-180.0, 180.0, _COLUMNS, endpoint=False)
    line = PchipInterpolator(_LINE_ANGLE, _LINE_HEIGHT)(np.abs(azimuth))
    # The fringe covers the forehead on one side of the parting.
    line -= 8.0 * np.exp(-(((azimuth + 24.0) / 20.0) ** 2)) - 5.0 * np.exp(
        -(((azimuth - 17.0) / 9.0) ** 2)
    )
    line -= 2.2 * np.sin(azimuth * 0.42) * smoothstep(np.abs(azimuth), 70.0, 40.0)
    turn = np.radians(azimuth)
    middle = np.array(style.skull.cranium)
    side = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    start = side * 300.0 + np.stack([0 * line, line, 0 * line - 8.0], axis=1)
    edge = trace(form, start, -side)
    low = np.arctan2(edge[:, 1] - middle[1], np.hypot(edge[:, 0], edge[:, 2] - middle[2]))
    along = np.concatenate([[0.0, 0.0, 0.01, 0.025], np.linspace(0.05, 1.0, _ROWS - 4)])
    rise = low + (0.5 * np.pi - 1e-3 - low) * along[:, None]
    outward = np.stack(
        [np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)], axis=-1
    )
    flat = outward.reshape(-1, 3)
    scalp = trace(form, middle + 300.0 * flat, -flat).reshape(outward.shape)
    height, lock = _thickness(along[:, None], azimuth, scalp)
    border = np.concatenate([[-2.5, 0.5, 1.8, 3.0], np.full(_ROWS - 4, 4.0)])[:, None]
    points = scalp + (border / 4.0 * height)[..., None] * outward
    shade = (0.60 + 0.62 * lock)[..., None] * np.array(style.palette.hair)
    return Piece(
        points.reshape(-1, 3), grid_faces(_ROWS, _COLUMNS, closed=True), shade.reshape(-1, 3)
    )


def _thickness(
    along: FloatArray, azimuth: FloatArray, scalp: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the height of the hair above the scalp [mm], and the profile of locks [0-1]."""
    x, y, z = scalp[..., 0], scalp[..., 1], scalp[..., 2]
    crown = smoothstep(along, 1.0, 0.72)
    swept = smoothstep(np.abs(azimuth + 18.0), 85.0, 20.0) * crown
    nape = smoothstep(np.abs(azimuth), 95.0, 150.0)
    volume = 6.5 + 10.0 * swept * smoothstep(along, 0.0, 0.25) + 3.0 * smoothstep(along, 0.2, 0.6)
    volume = volume - 2.5 * nape * smoothstep(along, 0.35, 0.0)
    top = smoothstep(y, 45.0, 75.0) * crown
    aside = x - _PARTING_X - 0.12 * (z - 60.0)
    volume = volume - 5.0 * np.exp(-((aside / 4.0) ** 2)) * top * smoothstep(z, -40.0, 10.0)
    # Locks run back from the forehead and away from the parting, in planes through the head.
    across = np.abs(aside) * 0.75 - 0.40 * y + 0.08 * z
    across = across + 2.0 * np.sin(0.045 * z + 0.03 * y)
    broad = 0.5 + 0.5 * np.sin(0.34 * across)
    fine = 0.5 + 0.5 * np.sin(0.95 * across + 1.4 * np.sin(0.05 * z))
    lock = 0.68 * broad**0.55 + 0.32 * fine
    relief = 3.6 * (lock - 0.6) * crown * smoothstep(along, 0.0, 0.05)
    return volume + relief, lock * crown + 0.55 * (1.0 - crown)
