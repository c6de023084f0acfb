"""The rings of the cage that run round the mouth and round the eye, down into both."""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.demo.cage_grid import EYE_COLUMNS, EYE_ROWS, MOUTH_COLUMNS, MOUTH_ROWS
from usdface.demo.half_cage import HalfCage, Mark
from usdface.demo.proportions import Style
from usdface.demo.sculpt import LID_THICKNESS, Form, trace


def lay_mouth(half: HalfCage, style: Style, form: Form, grid: IntArray) -> None:
    """Rings from the outside of the lips to the back of the mouth, from upper to lower middle."""
    m = style.mouth
    r0, r1, c1 = MOUTH_ROWS[0], MOUTH_ROWS[1], MOUTH_COLUMNS[1]
    outer = [*grid[r1, : c1 + 1], grid[r0 + 1, c1], *grid[r0, : c1 + 1][::-1]]
    outer = [int(i) for i in outer]
    side = np.array([1, 1, 1, 1, 0, -1, -1, -1, -1], float)
    across = np.array([0.0, 0.23, 0.55, 0.84, 1.0, 0.84, 0.55, 0.23, 0.0])
    high = np.array([0.86, 1.0, 0.80, 0.42, 0.0, -0.46, -0.86, -1.0, -1.0])
    height = np.where(side > 0, m.upper, m.lower) * high
    line = m.height + m.curve * across**2 - 0.6 * np.exp(-((across / 0.2) ** 2))
    border = np.stack([across * (m.half_width + 2.2), line + height, 0.0 * line], axis=1)

    def on_form(points: FloatArray) -> FloatArray:
        start = points * (1.0, 1.0, 0.0) + (0.0, 0.0, 200.0)
        return trace(form, start, np.tile((0.0, 0.0, -1.0), (len(points), 1)))

    border = on_form(border)
    full = np.array([0.75, 1.0, 0.85, 0.5, 0.0, 0.55, 0.95, 1.1, 1.1]) * m.fullness
    rim = np.stack([across * m.half_width, line, 0.0 * line], axis=1)
    face = on_form(rim)
    away = np.array([half.points[i] for i in outer])
    outside = on_form(border + 0.42 * (away - border))
    corner = np.exp(-(((across - 1.0) / 0.12) ** 2))
    rings = [
        (3.0, outside, 1.0),
        (2.0, border + np.stack([0 * full, 0 * full, 0.45 * full], 1), 0.0),
        (
            1.0,
            np.stack(
                [
                    across * (m.half_width + 1.0),
                    line + 0.50 * height,
                    face[:, 2] + full + 0.4 - 1.6 * corner,
                ],
                axis=1,
            ),
            0.0,
        ),
        (0.0, np.stack([rim[:, 0], line, face[:, 2] + 0.55 * full - 2.6], axis=1), 0.0),
    ]
    depth = (
        (-1.0, 1.00, 2.2, -6.5),
        (-2.0, 1.03, 8.0, -10.5),
        (-3.0, 1.06, 15.0, -24.0),
        (-4.0, 0.90, 14.0, -46.0),
    )
    for number, widen, lift, back in depth:
        x = across * m.half_width * widen + 1.2 * corner * min(-number, 2.0)
        y = line + lift * np.where(side == 0, 0.0, np.sign(side)) * (1.0 - 0.35 * across**2)
        z = face[:, 2] + back + 0.35 * (face[0, 2] - face[:, 2]) * (number < -1.0)
        rings.append((number, np.stack([x, y, z], axis=1), 0.0))
    previous = outer
    for index, ring_side in zip(outer, side, strict=True):
        half.mark(index, Mark.MOUTH_RING, 4.0)
        half.mark(index, Mark.MOUTH_SIDE, ring_side)
    for number, positions, settle in rings:
        positions[[0, -1], 0] = 0.0
        ring = [
            half.point(p, settle=settle, mouth_ring=number, mouth_side=s)
            for p, s in zip(positions, side, strict=True)
        ]
        half.strip(ring, previous)
        previous = ring
    # The back of the mouth: a row of points between the upper and the lower half of the last ring.
    ends = np.array([half.points[i] for i in previous])
    row = 0.5 * (ends[:4] + ends[:4:-1])
    deepest = [half.point(p, settle=0.0, mouth_ring=-5.0) for p in row]
    half.strip(deepest, previous[:4])
    half.strip(previous[:4:-1], deepest)
    half.faces.append((deepest[3], previous[5], previous[4], previous[3]))


def lay_eye(half: HalfCage, style: Style, form: Form, grid: IntArray) -> None:
    """Rings from the socket's rim over the crease and the lid to behind the eyeball."""
    e = style.eye
    r0, r1, (c0, c1) = EYE_ROWS[0], EYE_ROWS[1], EYE_COLUMNS
    upper = [int(i) for i in grid[r1, c0 : c1 + 1]]
    lower = [int(i) for i in grid[r0, c0 : c1 + 1]][::-1]
    outer = [int(grid[r0 + 1, c0]), *upper, int(grid[r0 + 1, c1]), *lower]
    side = np.array([0, 1, 1, 1, 1, 1, 0, -1, -1, -1, -1, -1], float)
    across = np.array([-1.0, -0.78, -0.40, 0.05, 0.48, 0.82, 1.0, 0.80, 0.42, -0.02, -0.44, -0.80])
    high = np.array([0.0, 0.62, 0.95, 1.0, 0.86, 0.5, 0.0, -0.62, -0.97, -1.0, -0.86, -0.48])
    opening = np.where(side > 0, e.open_up, e.open_down)
    center = np.array(e.center)
    tilt = e.tilt * across
    away = np.array([half.points[i] for i in outer])

    def lid(
        grow_x: float, grow_up: float, grow_down: float, radius: float | FloatArray
    ) -> FloatArray:
        """Points on a sphere round the eye, the opening grown by so much [mm]."""
        x = across * e.half_width + np.sign(across) * grow_x * np.abs(across) ** 2
        y = high * opening + np.where(side > 0, grow_up, -grow_down) * np.sqrt(np.abs(high)) + tilt
        flat = np.stack([x, y], axis=1)
        length = np.linalg.norm(flat, axis=1)
        flat *= (np.minimum(length, 0.985 * radius) / length)[:, None]
        z = np.sqrt(np.maximum(radius**2 - np.sum(flat**2, axis=1), 0.0))
        placed: FloatArray = center + np.column_stack([flat, z])
        return placed

    skin = e.radius + LID_THICKNESS
    rim = lid(0.0, 0.0, 0.0, skin)
    middle = lid(1.2, 3.6, 3.2, skin + 0.3)
    crease = lid(2.6, 5.6, 7.5, skin + np.where(side > 0, -0.2, 0.5))
    crease[:, 2] -= np.where(side > 0, 1.2, 0.0)
    fold = crease + 0.34 * (away - crease)
    fold[:, 2] += np.where(side > 0, 2.2, 0.0) * np.abs(high)
    fold[:, 1] -= np.where(side > 0, 1.2, 0.0) * np.abs(high)
    edge = center + (lid(-0.3, -0.5, -0.5, skin) - center) * (e.radius + 0.75) / skin
    tuck = center + (lid(1.2, 2.2, 2.2, skin) - center) * (e.radius + 0.9) / skin
    none = np.zeros_like(side)
    rings = [
        (3.0, fold, np.where(side > 0, 0.35, 1.0)),
        (2.0, crease, np.where(side > 0, 0.0, 0.85)),
        (1.0, middle, none),
        (0.0, rim, none),
        (-1.0, edge, none),
        (-2.0, tuck, none),
    ]
    previous = outer
    for index, ring_side in zip(outer, side, strict=True):
        half.mark(index, Mark.EYE_RING, 4.0)
        half.mark(index, Mark.EYE_SIDE, ring_side)
    for number, positions, settle in rings:
        ring = [
            half.point(p, settle=on_form, eye_ring=number, eye_side=s)
            for p, s, on_form in zip(positions, side, settle, strict=True)
        ]
        half.strip([*ring, ring[0]], [*previous, previous[0]])
        previous = ring
