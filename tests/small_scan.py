"""A scan without a rig: half an egg with a nose and a mouth that opens, and a take to move it."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, Vt

from usdface.core.assets import Markers, Take

WIDE, HIGH = 25, 31
MOUTH_ROW, MOUTH = 9, range(9, 16)
"""The row of the grid that is cut open, and the columns between the corners of the mouth."""

CALLED = {
    "skin_1_14": "chin_L",
    "skin_21_6": "brow_R",
    "skin_21_18": "brow_L",
}
"""Markers that have a name of their own."""

FRAMES = 40
FIRST = 101


@dataclass(frozen=True)
class Scan:
    """The mesh in millimetres, Y up, and what happens to it.

    Attributes
    ----------
    points : (points, 3) array
    counts, indices : int arrays
        Quads.
    upper, lower : (n,) int arrays
        The lips' edges: point by point they touch.
    markers : (m,) int array
        The points that carry the markers.
    names : tuple of str
    """

    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    markers: np.ndarray
    names: tuple[str, ...]

    def moved(self, jaw: float, smile: float = 0.0, brow: float = 0.0) -> np.ndarray:
        """The surface with the jaw open, a smile, and the brows up."""
        x, y = self.points[:, 0] / 70, self.points[:, 1] / 90
        mouth = self.points[self.upper[0], 1] / 90
        below = np.zeros(len(x), bool)
        below[len(x) - len(self.lower) :] = True
        below |= (y < mouth - 1e-6) & (np.arange(len(x)) < len(x) - len(self.lower))
        drop = (
            below * np.clip((0.75 - np.abs(x)) / 0.6, 0, 1) * np.clip(1 + (mouth - y) * 0.5, 0, 1)
        )
        out = self.points.copy()
        out[:, 1] -= 16 * jaw * drop
        pull = np.exp(-((np.abs(x) - 0.35) ** 2 + (y - mouth) ** 2) / 0.03)
        out += 7 * smile * pull[:, None] * np.stack([np.sign(x), 0.6 + 0 * x, 0 * x], axis=1)
        out[:, 1] += 6 * brow * np.exp(-((y - 0.5) ** 2) / 0.02)
        return out


def small_scan() -> Scan:
    """Build the scan."""
    u, v = np.meshgrid(np.linspace(-1, 1, WIDE), np.linspace(-1, 1, HIGH))
    depth = 55 * np.sqrt(np.maximum(2.3 - u**2 - v**2, 0))
    depth += 22 * np.exp(-(u**2) / 0.02 - (v - 0.05) ** 2 / 0.03)
    points = np.stack([70 * u, 90 * v, depth], axis=-1).reshape(-1, 3)
    upper = np.array([MOUTH_ROW * WIDE + c for c in MOUTH])
    lower = np.arange(len(points), len(points) + len(upper) - 2)
    points = np.concatenate([points, points[upper[1:-1]] - [0, 0.4, 0]])
    below = dict(zip(upper[1:-1].tolist(), lower.tolist(), strict=True))
    faces = []
    for row in range(HIGH - 1):
        for column in range(WIDE - 1):
            quad = [row * WIDE + column + step for step in (0, 1, WIDE + 1, WIDE)]
            faces.append([below.get(p, p) for p in quad] if row < MOUTH_ROW else quad)
    names, markers = [], []
    for number, (top, bottom) in enumerate(zip(upper[1:-1], lower, strict=True)):
        names += [f"lip_upper_{number}", f"lip_lower_{number}"]
        markers += [int(top), int(bottom)]
    for row in range(1, HIGH, 4):
        for column in range(2, WIDE, 4):
            name = f"skin_{row}_{column}"
            names.append(CALLED.get(name, name))
            markers.append(row * WIDE + column)
    names.append("nose tip")  # no name that a prim may have
    markers.append((HIGH // 2 + 1) * WIDE + WIDE // 2)
    keep = [i for i, p in enumerate(markers) if p not in markers[:i]]
    return Scan(
        points,
        np.full(len(faces), 4),
        np.ravel(faces),
        upper[1:-1],
        lower,
        np.array([markers[i] for i in keep]),
        tuple(names[i] for i in keep),
    )


def small_scan_take(scan: Scan, *, noise: float = 0.1, frames: int = FRAMES) -> Take:
    """A cleaned take of a performer of other size: 1/1.1 of the scan, turned and moved."""
    rng = np.random.default_rng(0)
    time = np.linspace(0, 2 * np.pi, frames)
    acted = np.stack(
        [
            scan.moved((1 - np.cos(t)) / 2, max(np.sin(2 * t), 0), max(np.sin(3 * t), 0))
            for t in time
        ]
    )[:, scan.markers]
    turn = np.array([[0.98, 0, 0.199], [0, 1, 0], [-0.199, 0, 0.98]])
    positions = (acted - [0, -20, 10]) @ turn.T / 1.1 + rng.normal(0, noise, acted.shape)
    count = len(scan.names)
    return Take(
        name="talk",
        rate=Fraction(60),
        first_frame=FIRST,
        markers=Markers(
            names=scan.names,
            positions=positions.astype(np.float32),
            visible=np.ones((frames, count), bool),
            confidence=np.ones((frames, count), np.float32),
            rigid=tuple(name for name in scan.names if name.startswith("skin_29_")),
            neutral_frame=FIRST,
            space="stabilized",
        ),
        timecode_start="10:00:00:00",
    )


def landmarks(scan: Scan) -> tuple[str, ...]:
    """Five markers that a person might point at, as the command line takes them."""
    chosen = ("nose tip", "chin_L", "lip_upper_0", "lip_lower_4", "brow_R")
    return tuple(f"{name}={scan.markers[scan.names.index(name)]}" for name in chosen)


def write_scan(
    path: Path, scan: Scan, *, z_up: bool = False, normals: str = "", scheme: str = "none"
) -> Path:
    """Write the scan as a USD file: centimetres, Y up, or metres, Z up, beside the origin."""
    stage = Usd.Stage.CreateNew(str(path))
    unit = 0.001 if z_up else 0.1
    UsdGeom.SetStageUpAxis(stage, "Z" if z_up else "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0 if z_up else 0.01)
    top = UsdGeom.Xform.Define(stage, "/Scan")
    stage.SetDefaultPrim(top.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/Scan/head")
    at = scan.points * unit
    if z_up:
        at = np.stack([at[:, 0], -at[:, 2], at[:, 1]], axis=1)
        api = UsdGeom.XformCommonAPI(top)
        api.SetTranslate(Gf.Vec3d(0.2, 0.1, 1.5))
        api.SetRotate((0, 0, 30))
        api.SetScale((2, 2, 2))
        at = at / 2
    mesh.CreatePointsAttr(vectors(at))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(scan.counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(scan.indices.astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(scheme)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(vectors(at)))
    if normals:
        count = len(at) if normals == "vertex" else len(scan.indices)
        mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * count)
        mesh.SetNormalsInterpolation(normals)
    stage.Save()
    return path


def vectors(values: np.ndarray) -> Vt.Vec3fArray:
    """Points as USD takes them."""
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))
