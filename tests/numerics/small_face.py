"""A face small enough for tests: a nose, lips that part, lids, and what lies behind them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]
MOUTH, EYES, EYE_X = -45.0, 30.0, 32.0


@dataclass(frozen=True)
class SmallFace:
    points: FloatArray
    triangles: NDArray[np.int64]
    offsets: FloatArray
    """(shapes, points, 3)"""
    names: tuple[str, ...]
    skin: NDArray[np.int64]
    """Points of the outer face; the others are the back of the head, a mouth bag, eyeballs."""

    @property
    def flat_offsets(self) -> sparse.csr_array:
        """(shapes, 3 * points)"""
        return sparse.csr_array(self.offsets.reshape(len(self.offsets), -1))


@dataclass(frozen=True)
class SmallActor:
    neutral: FloatArray
    positions: FloatArray
    weights: FloatArray
    carriers: NDArray[np.int64]
    """The character's point each marker belongs to."""
    scale: FloatArray
    """Character over performer."""


def _grid(rows: int, columns: int, start: int = 0) -> NDArray[np.int64]:
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel() + start
    return np.concatenate(
        [np.stack([a, a + 1, a + columns + 1], 1), np.stack([a, a + columns + 1, a + columns], 1)]
    )


def _ball(centre: tuple[float, float, float], radius: float, start: int):  # type: ignore[no-untyped-def]
    theta, phi = np.meshgrid(
        np.linspace(0.1, 3.04, 9), np.linspace(0, 2 * np.pi, 13), indexing="ij"
    )
    p = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    return p.reshape(-1, 3) * radius + centre, _grid(9, 13, start)


def small_face() -> SmallFace:
    u, v = np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 71))
    x, y = 78 * np.sin(1.25 * u).ravel() / np.sin(1.25), (100 * v).ravel()
    z = 75 * np.cos(1.25 * u).ravel() * np.sqrt(1 - 0.55 * v.ravel() ** 2)
    z += 24 * np.exp(
        -((x / 10) ** 2) - (np.maximum(-y - 5, 0) / 8) ** 2 - (np.maximum(y + 5, 0) / 26) ** 2
    )
    z += 6 * np.exp(-((x / 26) ** 2) - ((y - MOUTH) / 12) ** 2) - 2 * np.exp(
        -(((y - MOUTH) / 2) ** 2)
    )
    z += 5 * np.exp(-(((y + 82) / 14) ** 2) - (x / 25) ** 2)
    for side in (-1, 1):
        z -= 7 * np.exp(-(((x - side * EYE_X) / 14) ** 2) - ((y - EYES) / 9) ** 2)
    skin = np.stack([x, y, z], axis=1)
    shapes: dict[str, FloatArray] = {}

    def bump(cx: float, cy: float, sx: float, sy: float) -> FloatArray:
        return np.exp(-0.5 * (((x - cx) / sx) ** 2 + ((y - cy) / sy) ** 2))

    def add(name: str, share: FloatArray, direction: tuple[float, float, float]) -> None:
        shapes[name] = shapes.get(name, np.zeros_like(skin)) + share[:, None] * np.array(direction)

    lower = (y < MOUTH).astype(float)
    upper = 1 - lower
    add("jawOpen", lower * np.exp(-((x / 62) ** 4)), (0, -22, -6))
    add("jawSide", lower * np.exp(-((x / 62) ** 4)), (8, 0, 0))
    add("upperUp", bump(0, MOUTH + 5, 18, 8) * upper, (0, 6, 2))
    add("lowerDown", bump(0, MOUTH - 6, 18, 8) * lower, (0, -7, 1))
    add("pucker", bump(0, MOUTH, 20, 11), (0, 0, 8))
    add("puff", bump(-42, -25, 15, 15) + bump(42, -25, 15, 15), (0, 0, 9))
    for side, tag in ((1, "L"), (-1, "R")):
        c = side * EYE_X
        add(f"smile{tag}", bump(side * 27, MOUTH, 12, 10), (side * 9, 9, -5))
        add(f"frown{tag}", bump(side * 25, MOUTH - 4, 12, 10), (side * 2, -8, -2))
        add(f"blink{tag}", bump(c, EYES + 5, 10, 4) * (y > EYES), (0, -9, 1))
        add(f"squint{tag}", bump(c, EYES - 7, 12, 5) * (y <= EYES), (0, 5, 1))
        add(f"browUp{tag}", bump(c, 55, 20, 11), (0, 10, 1))
        add(f"browDown{tag}", bump(side * 22, 52, 15, 9), (-side * 4, -7, 0))
        add(f"sneer{tag}", bump(side * 13, -8, 8, 12), (0, 6, 2))
    back = skin * (1, 1, -1) - (0, 0, 5)
    bag = np.stack([x, y, z], axis=1)[np.abs(y - MOUTH) < 9].reshape(-1, 61, 3)
    bag = bag[:, 20:41] - (0, 0, 22)
    parts, triangles = [skin, back, bag.reshape(-1, 3)], [_grid(71, 61)]
    triangles.append(_grid(71, 61, len(skin))[:, ::-1])
    triangles.append(_grid(len(bag), 21, 2 * len(skin)))
    for side in (-1, 1):
        ball, faces = _ball((side * EYE_X, EYES, 48.0), 10, sum(len(part) for part in parts))
        parts.append(ball)
        triangles.append(faces)
    points = np.concatenate(parts)
    offsets = np.zeros((len(shapes), len(points), 3))
    offsets[:, : len(skin)] = list(shapes.values())
    inside = slice(2 * len(skin), 2 * len(skin) + bag.shape[0] * 21)
    offsets[0, inside] = (0, -22, -6)  # the jaw takes the inside of the mouth along
    return SmallFace(
        points, np.concatenate(triangles), offsets, tuple(shapes), np.arange(len(skin))
    )


def small_actor(
    face: SmallFace,
    rng: np.random.Generator,
    *,
    markers: int = 70,
    frames: int = 240,
    yaw: float = 0,
) -> SmallActor:
    """Glue markers to the face, give it other proportions, perform, and turn it away."""
    edge = (np.abs(face.points[face.skin, 0]) < 70) & (np.abs(face.points[face.skin, 1]) < 92)
    pool = face.skin[edge]
    carriers, distance = [int(pool[rng.integers(len(pool))])], np.full(len(pool), np.inf)
    share = 0.4 + np.linalg.norm(face.offsets[:, pool], axis=2).max(axis=0) / 22
    for _ in range(markers - 1):
        step = np.linalg.norm(face.points[pool] - face.points[carriers[-1]], axis=1)
        distance = np.minimum(distance, step)
        carriers.append(int(pool[np.argmax(distance * share)]))
    weights = np.zeros((frames, len(face.names)))
    time = np.arange(frames)
    for column in weights.T:
        for centre in rng.uniform(0, frames, frames // 60):
            pulse = rng.uniform(0.3, 1) * np.exp(-0.5 * ((time - centre) / 5) ** 2)
            np.maximum(column, pulse, out=column)
    scale = np.array([1.1, 0.9, 1.05])
    turn = Rotation.from_euler("yxz", [yaw, 6, -4], degrees=True).as_matrix()
    deltas = face.offsets[:, carriers]
    smooth = 3 * np.sin(face.points[carriers] / 40)[:, [1, 2, 0]]
    still = ((face.points[carriers] + smooth) / scale) @ turn.T + (120, -40, 900)
    motion = (np.einsum("fs,smc->fmc", weights, deltas) / scale) @ turn.T
    motion += rng.normal(0, 0.1, motion.shape)
    return SmallActor(still, still + motion, weights, np.array(carriers), scale)
