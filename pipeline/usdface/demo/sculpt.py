"""Proportions of two people, and their heads as signed distance functions.

The form is a smooth union of ellipsoids and capsules, whose zero set is the skin without the lips
and the edges of the lids, which `usdface.demo.cage` adds.

Proportions are in millimetres, Y up, Z forward, X towards the person's left; the origin is between
the eyes, on the axis through the ears. Only the left half is described.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from usdface.core.arrays import FloatArray, distances, row_lengths

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Skull:
    """Centres and radii of the forms of the bare head."""

    cranium: Vec = (0.0, 38.0, -12.0)
    cranium_radii: Vec = (76.0, 80.0, 94.0)
    face: Vec = (0.0, -28.0, 20.0)
    face_radii: Vec = (56.5, 76.0, 66.0)
    jaw_angle: Vec = (38.5, -62.0, 0.0)
    jaw_radius: float = 12.5
    chin: Vec = (0.0, -99.0, 68.0)
    chin_radii: Vec = (15.0, 13.0, 15.0)
    cheekbone: Vec = (40.0, -18.0, 52.0)
    cheekbone_radii: Vec = (20.0, 16.0, 19.0)
    cheek: Vec = (31.0, -42.0, 54.5)
    cheek_radii: Vec = (23.0, 23.0, 24.0)
    jowl: Vec = (30.0, -64.0, 38.0)
    jowl_radii: Vec = (16.5, 22.0, 26.0)
    muzzle: Vec = (0.0, -70.0, 58.0)
    muzzle_radii: Vec = (30.0, 26.0, 28.0)
    brow_height: float = 22.0
    brow_depth: float = 75.0
    brow_radius: float = 9.0
    neck_front: float = 12.0
    neck_back: float = -56.0
    neck_half: float = 36.0


@dataclass(frozen=True)
class Eye:
    """The eyeball and the opening of the lids over it."""

    center: Vec = (31.0, 0.0, 59.0)
    radius: float = 20.5
    half_width: float = 17.0
    open_up: float = 9.0
    open_down: float = 7.5
    tilt: float = 1.2
    socket: float = 9.0
    iris: float = 0.50


@dataclass(frozen=True)
class Nose:
    """The nose, from its root between the eyes to the base on the lip."""

    root: tuple[float, float] = (2.0, 82.0)
    tip: tuple[float, float] = (-35.5, 102.5)
    base: tuple[float, float] = (-46.0, 86.5)
    bridge_radius: float = 5.5
    tip_radius: float = 7.6
    wing: Vec = (9.0, -40.0, 88.0)
    wing_radii: Vec = (5.0, 5.6, 8.0)


@dataclass(frozen=True)
class Mouth:
    """Line, heights and fullness of the lips."""

    height: float = -67.0
    half_width: float = 23.0
    curve: float = 3.0
    upper: float = 6.5
    lower: float = 9.0
    fullness: float = 4.4


@dataclass(frozen=True)
class HeadColors:
    """Linear display colours."""

    skin: Vec = (0.68, 0.40, 0.285)
    lip: Vec = (0.56, 0.19, 0.165)
    iris: Vec = (0.075, 0.175, 0.095)
    hair: Vec = (0.15, 0.058, 0.022)
    brow: Vec = (0.075, 0.030, 0.013)


@dataclass(frozen=True)
class Style:
    """The proportions and colours of one person."""

    name: str
    skull: Skull = field(default_factory=Skull)
    eye: Eye = field(default_factory=Eye)
    nose: Nose = field(default_factory=Nose)
    mouth: Mouth = field(default_factory=Mouth)
    palette: HeadColors = field(default_factory=HeadColors)


CHARACTER = Style("character")
"""The rig: large eyes, small nose, a narrow chin."""

ACTOR = Style(
    "actor",
    skull=Skull(
        cranium=(0.0, 40.0, -14.0),
        cranium_radii=(75.0, 79.0, 95.0),
        face=(0.0, -32.0, 18.0),
        face_radii=(59.0, 82.0, 67.0),
        jaw_angle=(43.0, -72.0, 0.0),
        jaw_radius=14.0,
        chin=(0.0, -111.0, 67.0),
        chin_radii=(19.0, 14.0, 16.0),
        cheekbone=(43.0, -22.0, 50.0),
        cheekbone_radii=(19.0, 15.0, 18.0),
        cheek=(30.0, -52.0, 52.0),
        cheek_radii=(22.0, 26.0, 24.0),
        jowl=(33.0, -70.0, 34.0),
        jowl_radii=(17.0, 25.0, 27.0),
        muzzle=(0.0, -77.0, 57.0),
        muzzle_radii=(31.0, 27.0, 28.0),
        brow_height=18.0,
        brow_depth=77.0,
        brow_radius=10.5,
        neck_front=16.0,
        neck_back=-60.0,
        neck_half=46.0,
    ),
    eye=Eye(
        center=(31.5, 0.0, 61.0),
        radius=16.5,
        half_width=14.6,
        open_up=6.4,
        open_down=5.2,
        tilt=0.6,
        socket=10.0,
        iris=0.47,
    ),
    nose=Nose(
        root=(2.0, 84.0),
        tip=(-43.0, 107.0),
        base=(-51.5, 89.0),
        bridge_radius=7.5,
        tip_radius=9.5,
        wing=(11.0, -46.5, 91.0),
        wing_radii=(6.0, 7.0, 10.0),
    ),
    mouth=Mouth(height=-75.5, half_width=25.0, curve=0.8, upper=4.8, lower=7.0, fullness=3.6),
    palette=HeadColors(
        skin=(0.60, 0.345, 0.24),
        lip=(0.47, 0.175, 0.145),
        iris=(0.07, 0.14, 0.24),
        hair=(0.030, 0.019, 0.013),
        brow=(0.022, 0.014, 0.010),
    ),
)
"""The performer: longer nose and jaw, smaller eyes, thinner lips."""


Form = Callable[[FloatArray], FloatArray]


def ellipsoid(points: FloatArray, center: Vec, radii: Vec) -> FloatArray:
    """Return the approximate signed distance to an ellipsoid; exact on its surface."""
    scaled = (points - center) / radii
    near, gradient = row_lengths(scaled)[..., 0], row_lengths(scaled / radii)[..., 0]
    return np.asarray(near * (near - 1.0) / np.maximum(gradient, 1e-6))


def capsule(
    points: FloatArray, start: Vec, stop: Vec, start_radius: float, stop_radius: float
) -> FloatArray:
    """Return the approximate signed distance to a capsule with a linearly varying radius."""
    axis = np.subtract(stop, start)
    offset = points - start
    along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
    radius = start_radius + along * (stop_radius - start_radius)
    return np.asarray(distances(offset, along[..., None] * axis) - radius)


def blend(first: FloatArray, second: FloatArray, rounding: float) -> FloatArray:
    """Return the union of two forms with a cubic fillet of about `rounding` mm."""
    overlap = np.maximum(rounding - np.abs(first - second), 0.0) / rounding
    return np.minimum(first, second) - overlap**3 * rounding / 6.0


def carve(form: FloatArray, tool: FloatArray, rounding: float) -> FloatArray:
    """Return the difference of two forms with a fillet."""
    return -blend(-form, tool, rounding)


def head_form(style: Style) -> Form:
    """Return the signed distance function of a style's bare head, symmetric in x.

    From (..., 3) [mm] to (...) [mm], negative inside.
    """

    def distance(points: FloatArray) -> FloatArray:
        p = np.array(points, float)
        p[..., 0] = np.abs(p[..., 0])
        d = _skull(style, p)
        d = _face(style, d, p)
        d = _nose(style, d, p)
        return _eye(style, d, p)

    return distance


def _skull(style: Style, p: FloatArray) -> FloatArray:
    s = style.skull
    d = ellipsoid(p, s.cranium, s.cranium_radii)
    d = blend(d, ellipsoid(p, s.face, s.face_radii), 40.0)
    chin_corner = (s.chin[0] + 9.0, s.chin[1] + 1.0, s.chin[2] - 4.0)
    jaw = capsule(p, s.jaw_angle, chin_corner, s.jaw_radius, s.chin_radii[1] - 1.0)
    d = blend(d, jaw, 32.0)
    middle = 0.5 * (s.neck_front + s.neck_back)
    radius = 0.5 * (s.neck_front - s.neck_back)
    slim = p * (radius / s.neck_half, 1.0, 1.0)
    top, bottom = (0.0, -55.0, middle), (0.0, -240.0, middle - 8.0)
    neck = capsule(slim, top, bottom, radius - 2.0, radius + 3.0)
    return blend(d, neck, 26.0)


def _face(style: Style, d: FloatArray, p: FloatArray) -> FloatArray:
    s, m = style.skull, style.mouth
    d = blend(d, ellipsoid(p, s.chin, s.chin_radii), 16.0)
    d = blend(d, ellipsoid(p, s.cheekbone, s.cheekbone_radii), 32.0)
    d = blend(d, ellipsoid(p, s.cheek, s.cheek_radii), 24.0)
    d = blend(d, ellipsoid(p, s.jowl, s.jowl_radii), 24.0)
    d = blend(d, ellipsoid(p, s.muzzle, s.muzzle_radii), 20.0)
    inner = (9.0, s.brow_height - 3.0, s.brow_depth)
    outer = (50.0, s.brow_height - 1.0, s.brow_depth - 21.0)
    d = blend(d, capsule(p, inner, outer, s.brow_radius, s.brow_radius - 2.0), 18.0)
    fold = (0.0, m.height - m.lower - 7.0, s.muzzle[2] + s.muzzle_radii[2] + 4.0)
    return carve(d, ellipsoid(p, fold, (17.0, 4.5, 5.5)), 9.0)


def _nose(style: Style, d: FloatArray, p: FloatArray) -> FloatArray:
    n = style.nose
    root = (0.0, n.root[0], n.root[1] - n.bridge_radius)
    tip = (0.0, n.tip[0], n.tip[1] - n.tip_radius)
    d = blend(d, capsule(p, root, tip, n.bridge_radius, n.tip_radius * 0.72), 13.0)
    columella = (0.0, n.base[0] + 3.5, n.base[1] - 3.0)
    d = blend(d, capsule(p, columella, (0.0, tip[1], tip[2] - 2.0), 3.6, 5.0), 4.0)
    d = blend(d, ellipsoid(p, n.wing, n.wing_radii), 7.0)
    ball = ellipsoid(p, tip, (n.tip_radius, n.tip_radius * 0.92, n.tip_radius))
    d = blend(d, ball, 6.0)
    groove = n.base[0] - 1.0, style.mouth.height + style.mouth.upper
    z = n.base[1] + 2.0
    philtrum = capsule(p, (0.0, groove[0], z), (0.0, groove[1], z + 3.0), 2.2, 3.2)
    return carve(d, philtrum, 3.5)


def _eye(style: Style, d: FloatArray, p: FloatArray) -> FloatArray:
    e = style.eye
    x, y, z = e.center
    socket = ellipsoid(
        p, (x - 1.0, y + 5.0, z + e.radius + 3.0), (e.half_width + 7.0, 17.0, e.socket + 2.0)
    )
    d = carve(d, socket, 14.0)
    corner = ellipsoid(p, (x - e.half_width - 3.0, y + 2.0, z + e.radius + 3.0), (6.0, 8.0, 7.0))
    d = carve(d, corner, 8.0)
    lids = distances(p, np.array(e.center)) - (e.radius + LID_THICKNESS)
    return blend(d, lids, 10.0)


LID_THICKNESS = 2.2
"""Distance of the outer skin of the lids from the eyeball [mm]."""


_ON_SURFACE_MM = 1e-9  # distance at which a ray has arrived


def trace(form: Form, origins: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the first intersections of rays from outside with the form: (n, 3).

    `origins`, `directions`: (n, 3); directions need not be normalised; a ray that misses ends at
    its nearest point.
    """
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.array(origins, dtype=float)
    nearest, best = points.copy(), np.full(len(points), np.inf)
    away = np.arange(len(points))
    for _ in range(80):
        value = form(points[away])
        closer = value < best[away]
        rows = away[closer]
        nearest[rows], best[rows] = points[rows], value[closer]
        points[away] += 0.75 * np.minimum(value, 30.0)[:, None] * unit[away]
        away = away[np.abs(value) > _ON_SURFACE_MM]
    return nearest


def settle(form: Form, points: FloatArray, amount: FloatArray) -> FloatArray:
    """Move points along the form's gradient towards its surface, by a share `amount` each [0-1]."""
    step = 0.05
    moved = np.array(points)
    for _ in range(4):
        value = form(moved)
        gradient = np.stack(
            [form(moved + step * axis) - form(moved - step * axis) for axis in np.eye(3)], axis=1
        ) / (2.0 * step)
        scale = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.2)
        moved -= np.clip(value / scale, -6.0, 6.0)[:, None] * gradient
    return points + amount[:, None] * (moved - points)
