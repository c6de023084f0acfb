"""The cage of the head: a grid, with rings of points around the mouth and the eye.

The grid has rows from the neck to the crown and columns from the midline to the nape; two blocks
are left open for the rings.
"""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.demo.half_cage import HalfCage, Mark
from usdface.demo.sculpt import LID_THICKNESS, Form, Style, trace

_COLUMN_COUNT = 12
ROW_COUNT = 21
EYE_ROWS, EYE_COLUMNS = (12, 14), (2, 6)
MOUTH_ROWS, MOUTH_COLUMNS = (6, 8), (0, 3)


def lay_grid(half: HalfCage, style: Style, form: Form) -> IntArray:
    """Place the grid's points on the form; return their indices, -1 inside the two blocks."""
    guess, aim = _grid_guess(style)
    flat, towards = guess.reshape(-1, 3), aim.reshape(-1, 3)
    start = flat - 160.0 * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    hit = trace(form, start, towards).reshape(guess.shape)
    hit[:, [0, -1], 0] = 0.0
    grid = np.full((ROW_COUNT, _COLUMN_COUNT), -1)
    for r in range(ROW_COUNT):
        for c in range(_COLUMN_COUNT):
            in_eye = EYE_ROWS[0] < r < EYE_ROWS[1] and EYE_COLUMNS[0] < c < EYE_COLUMNS[1]
            in_mouth = MOUTH_ROWS[0] < r < MOUTH_ROWS[1] and c < MOUTH_COLUMNS[1]
            if not (in_eye or in_mouth):
                grid[r, c] = half.point(hit[r, c])
    for r, c, position in _nose_points(style):
        half.points[grid[r, c]] = np.array(position)
    return grid


def _grid_guess(style: Style) -> tuple[FloatArray, FloatArray]:
    """Return starting positions and directions of the rays that place the grid on the form."""
    s, e, n, m = style.skull, style.eye, style.nose, style.mouth
    ex, ey = e.center[:2]
    low, base = m.height - m.lower - 8.0, n.base[0]
    chin, jaw = s.chin[1], s.jaw_angle[1]
    eye_low, eye_top = ey - e.open_down - 11.0, ey + e.open_up + 7.0
    brow = ey + s.brow_height + 2.0
    # Per row: height at the midline and at the ear (columns 8 and 9), then at the nape.
    heights = np.array(
        [
            (chin - 100.0, chin - 96.0, chin - 90.0),
            (chin - 53.0, chin - 47.0, chin - 39.0),
            (chin - 28.0, jaw - 52.0, jaw - 40.0),
            (chin - 17.0, jaw - 29.0, jaw - 22.0),
            (chin - 9.0, jaw - 15.0, jaw - 10.0),
            (chin + 2.0, jaw - 3.0, jaw),
            (low, jaw + 6.0, jaw + 10.0),
            (m.height, jaw + 13.0, jaw + 18.0),
            (base, -42.0, -36.0),
            (base + 4.0, -35.0, -28.0),
            (n.tip[0], -28.0, -20.0),
            (n.tip[0] + 9.0, -21.0, -12.0),
            (eye_low, -14.0, -4.0),
            (ey, 0.0, 8.0),
            (eye_top, 14.0, 20.0),
            (brow, 27.0, 31.0),
            (brow + 15.0, 41.0, 43.0),
            (brow + 32.0, 57.0, 57.0),
            (brow + 49.0, 75.0, 73.0),
            (brow + 66.0, 92.0, 90.0),
            (brow + 78.0, 106.0, 104.0),
        ]
    )
    inner, outer = ex - e.half_width - 3.0, ex + e.half_width + 4.0
    eye_columns = np.linspace(inner, outer, 5)
    # Per row: x of columns 0 to 6, whose rays run straight back.
    mouth_x = [0.0, 9.0, 18.0, m.half_width + 5.0]
    wide = np.array([0.0, 6.5, 15.0, 24.0, 35.0, 46.0, 56.0])
    across = np.tile(wide, (ROW_COUNT, 1))
    across[:3] = np.array([0.0, 5.0, 10.5, 16.5, 23.0, 30.0, 37.0])
    across[3] = np.array([0.0, 7.0, 14.0, 22.0, 30.0, 38.0, 45.0])
    across[4] = np.array([0.0, 8.0, 16.0, 25.0, 33.5, 42.0, 49.0])
    across[5] = np.array([0.0, 9.0, 18.0, 26.5, 34.0, 40.5, 45.5])
    across[6] = np.array([*mouth_x, 36.5, 43.5, 48.5])
    across[7] = np.array([0.0, 9.0, 18.0, m.half_width + 9.0, 39.5, 46.0, 50.5])
    across[8] = np.array([0.0, 4.5, 14.0, m.half_width + 4.0, 38.0, 46.0, 51.5])
    across[9] = np.array([0.0, 5.0, 16.0, 26.0, 37.0, 46.0, 52.5])
    across[10] = np.array([0.0, 6.0, 17.0, 25.5, 36.5, 46.0, 53.0])
    across[11] = np.array([0.0, 6.0, 14.0, 22.5, 34.0, 45.5, 53.5])
    across[12, 1:] = np.array([5.5, *eye_columns])
    across[13, 1:] = np.array([5.0, *eye_columns])
    across[13, 2], across[13, 6] = inner - 2.0, outer + 2.5
    across[14, 1:] = np.array([5.5, *eye_columns])
    across[15, 1:] = np.array([6.0, *np.linspace(inner + 1.0, outer, 5)])
    for row in range(16, ROW_COUNT):
        across[row, 1:7] = np.linspace(9.0, 55.0, 6) * (1.0 - 0.055 * (row - 16))

    y = np.empty((ROW_COUNT, _COLUMN_COUNT))
    turn = np.array([0.0, 0.0, 0.0, 0.06, 0.2, 0.42, 0.66, 0.86, 1.0, 1.0])
    y[:, :10] = heights[:, :1] + turn * (heights[:, 1:2] - heights[:, :1])
    y[:, 10:] = heights[:, 1:2] + np.array([0.6, 1.0]) * (heights[:, 2:] - heights[:, 1:2])
    eye_drop = np.array([0.0, 0.0, 0.2, 0.2, 0.2, 0.2, 0.2])
    for row in (12, 13, 14):  # level rows round the eye
        y[row, :7] = heights[row, 0] + eye_drop * (e.tilt if row == 13 else 0.0)
    y[12, :2] += 4.0
    y[12, [2, 6]] += 2.5
    y[14, [2, 6]] -= 3.0
    y[14, :2] -= 3.0
    y[15, 2:7] += np.array([-2.0, 1.0, 2.5, 1.5, -3.5])

    guess, aim = np.zeros((ROW_COUNT, _COLUMN_COUNT, 3)), np.zeros((ROW_COUNT, _COLUMN_COUNT, 3))
    guess[..., 1] = y
    guess[:, :7, 0] = across
    aim[:, :7, 2] = -1.0
    azimuth = np.radians([66.0, 88.0, 112.0, 146.0, 180.0])
    guess[:, 7:, 2] = -10.0
    aim[:, 7:, 0], aim[:, 7:, 2] = -np.sin(azimuth), -np.cos(azimuth)
    # Rays to the neck and the underside of the jaw run towards the neck's axis.
    neck = np.radians([0, 9, 19, 30, 42, 54, 66, 80, 97, 118, 148, 180])
    guess[:3, :, 0], guess[:3, :, 2] = 0.0, -20.0
    aim[:3, :, 0], aim[:3, :, 2] = -np.sin(neck), -np.cos(neck)
    guess[2, :7, 1] += 2.0
    guess[3, :7, 0] = [0.0, 7.0, 14.5, 21.5, 27.5, 32.0, 35.5]
    guess[3, :7, 2] = [56.0, 55.0, 52.0, 46.0, 38.0, 29.0, 19.0]
    aim[3, :7] = (0.0, 1.0, 0.12)
    guess[4, :7, 2] = [78.0, 77.0, 72.0, 60.0, 46.0, 33.0, 20.0]
    aim[4, :7] = (0.0, 0.85, -0.53)
    return _swept_crown(guess, aim)


def _swept_crown(guess: FloatArray, aim: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Aim the rows above the forehead at the centre of the skull, evenly spaced over its top."""
    middle = np.array([0.0, 30.0, -12.0])
    azimuth = np.radians([0.0, 9.0, 18.0, 28.0, 39.0, 51.0, 63.0, 75.0, 92.0, 114.0, 147.0, 180.0])
    for row in range(16, ROW_COUNT):
        rise = np.radians(np.interp(row, [15, 20], [16.0, 76.0]))
        back = np.radians(np.interp(row, [15, 20], [6.0, 74.0]))
        up = rise + (back - rise) * azimuth / np.pi
        outward = np.stack(
            [np.sin(azimuth) * np.cos(up), np.sin(up), np.cos(azimuth) * np.cos(up)], axis=-1
        )
        guess[row], aim[row] = middle, -outward
    return guess, aim


def _nose_points(style: Style) -> list[tuple[int, int, tuple[float, float, float]]]:
    """Return row, column and position of points of the nose, which are placed explicitly."""
    n = style.nose
    (tip_y, tip_z), (base_y, base_z) = n.tip, n.base
    wx, wy, wz = n.wing
    side = wx + n.wing_radii[0]
    return [
        (8, 0, (0.0, base_y - 0.5, base_z + 0.5)),
        (8, 1, (3.6, base_y - 0.3, base_z + 0.2)),
        (8, 2, (wx + 1.5, base_y + 0.8, wz - 5.0)),
        (9, 0, (0.0, base_y + 3.0, tip_z - 5.0)),
        (9, 1, (4.4, base_y + 3.6, tip_z - 6.0)),
        (9, 2, (side - 2.4, base_y + 2.6, wz + 4.5)),
        (10, 0, (0.0, tip_y, tip_z + 0.5)),
        (10, 1, (7.0, tip_y - 1.0, tip_z - 4.5)),
        (10, 2, (side + 0.6, wy + 1.0, wz)),
        (11, 1, (6.8, tip_y + 7.5, tip_z - 8.0)),
        (11, 2, (wx + 1.5, wy + 8.0, wz - 1.0)),
    ]


def lay_grid_faces(half: HalfCage, grid: IntArray) -> None:
    """Add quads of the grid outside the blocks, of the crown and of the nostril."""
    for r in range(ROW_COUNT - 1):
        for c in range(_COLUMN_COUNT - 1):
            in_eye = EYE_ROWS[0] <= r < EYE_ROWS[1] and EYE_COLUMNS[0] <= c < EYE_COLUMNS[1]
            in_mouth = MOUTH_ROWS[0] <= r < MOUTH_ROWS[1] and c < MOUTH_COLUMNS[1]
            if in_eye or in_mouth or (r, c) == (8, 1):
                continue
            half.strip([grid[r, c], grid[r, c + 1]], [grid[r + 1, c], grid[r + 1, c + 1]])
    # The crown: joins the front half of the top ring to its back half.
    top = [int(i) for i in grid[-1]]
    middle = _COLUMN_COUNT // 2
    half.strip(top[:middle], top[: middle - 1 : -1])
    rim = [int(grid[8, 1]), int(grid[8, 2]), int(grid[9, 2]), int(grid[9, 1])]
    _nostril(half, rim)


def _nostril(half: HalfCage, rim: list[int]) -> None:
    """Add the nostril as a pit in the quad between columella and wing."""
    corners = np.array([half.points[i] for i in rim])
    middle = corners.mean(axis=0)
    ring = rim
    steps = (
        (0.74, (0.0, 0.6, 0.0), 0.1),
        (0.62, (0.5, 4.0, -1.5), 0.8),
        (0.4, (0.5, 9.0, -4.0), 1.0),
    )
    for scale, lift, depth in steps:
        inner = [
            half.point(middle + scale * (corner - middle) + lift, settle=0.0, nostril=depth)
            for corner in corners
        ]
        half.strip([*ring, ring[0]], [*inner, inner[0]])
        ring = inner
    half.faces.append((ring[0], ring[1], ring[2], ring[3]))
    for index in rim:
        half.marks[index][Mark.SETTLE] = 0.35


def lay_mouth(half: HalfCage, style: Style, form: Form, grid: IntArray) -> None:
    """Add rings from around the lips to the back of the mouth, from upper to lower midline."""
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
        half.marks[index][[Mark.MOUTH_RING, Mark.MOUTH_SIDE]] = 4.0, ring_side
    for number, positions, settle in rings:
        positions[[0, -1], 0] = 0.0
        ring = [
            half.point(p, settle=settle, mouth_ring=number, mouth_side=s)
            for p, s in zip(positions, side, strict=True)
        ]
        half.strip(ring, previous)
        previous = ring
    # The back of the mouth: a row between the upper and the lower half of the last ring.
    ends = np.array([half.points[i] for i in previous])
    row = 0.5 * (ends[:4] + ends[:4:-1])
    deepest = [half.point(p, settle=0.0, mouth_ring=-5.0) for p in row]
    half.strip(deepest, previous[:4])
    half.strip(previous[:4:-1], deepest)
    half.faces.append((deepest[3], previous[5], previous[4], previous[3]))


def lay_eye(half: HalfCage, style: Style, grid: IntArray) -> None:
    """Add rings from the rim of the socket over crease and lid to behind the eyeball."""
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
        """Return points on a sphere around the eye, with the opening enlarged [mm]."""
        x = across * e.half_width + np.sign(across) * grow_x * np.abs(across) ** 2
        y = high * opening + np.where(side > 0, grow_up, -grow_down) * np.sqrt(np.abs(high)) + tilt
        flat = np.stack([x, y], axis=1)
        length = np.linalg.norm(flat, axis=1)
        flat *= (np.minimum(length, 0.985 * radius) / length)[:, None]
        z = np.sqrt(np.maximum(radius**2 - np.sum(flat**2, axis=1), 0.0))
        return np.asarray(center + np.column_stack([flat, z]))

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
        half.marks[index][[Mark.EYE_RING, Mark.EYE_SIDE]] = 4.0, ring_side
    for number, positions, settle in rings:
        ring = [
            half.point(p, settle=on_form, eye_ring=number, eye_side=s)
            for p, s, on_form in zip(positions, side, settle, strict=True)
        ]
        half.strip([*ring, ring[0]], [*previous, previous[0]])
        previous = ring
