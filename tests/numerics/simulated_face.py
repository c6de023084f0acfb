"""A face that moves, with its truth: what the cleaning tests damage and mend."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.rigid_alignment import alignment_of, remove_motion
from usdface.numerics.rigid.stabilization import Stabilization


@dataclass(frozen=True)
class SimulatedFace:
    """Captured markers, and what they would be without noise, gaps, swaps and head motion."""

    captured: np.ndarray
    visible: np.ndarray
    truth: np.ndarray
    rigid: tuple[int, ...]
    swaps: tuple[tuple[int, int, int, int], ...]
    swapped: np.ndarray
    strays: np.ndarray


def simulate_face(
    *,
    frames: int = 3000,
    rate: float = 120.0,
    markers: int = 70,
    noise: float = 0.15,
    swapped_share: float = 0.0,
    dropout_share: float = 0.0,
    stray_count: int = 0,
    seed: int = 0,
) -> SimulatedFace:
    """Skin moves in sixteen regions and blinks; eight markers are on the skull."""
    rng = np.random.default_rng(seed)
    rest = _spread(rng, markers + 8)
    rigid = tuple(np.argsort(rest[:, 1])[-8:].tolist())
    truth = rest + _skin_motion(rng, rest, rigid, frames, rate)
    captured = _head_motion(rng, truth, frames, rate)
    captured += noise * rng.standard_normal(captured.shape)
    swaps = _draw_swaps(rng, rest, frames, rate, swapped_share)
    swapped = np.zeros(captured.shape[:2], bool)
    for first, second, start, stop in swaps:
        captured[start:stop, [first, second]] = captured[start:stop, [second, first]]
        swapped[start:stop, [first, second]] = True
    strays = np.zeros_like(swapped)
    for _ in range(stray_count):
        start, marker = int(rng.integers(frames - 20)), int(rng.integers(len(rest)))
        stop = start + int(rng.integers(1, 12))
        captured[start:stop, marker] += rng.normal(0, 15, 3) + 10
        strays[start:stop, marker] = True
    visible = _draw_dropouts(rng, captured.shape[:2], rate, dropout_share)
    held = np.where(visible[..., None], captured, 0.0)
    return SimulatedFace(held, visible, truth, rigid, swaps, swapped, strays & visible)


def _spread(rng: np.random.Generator, count: int) -> np.ndarray:
    """Markers on half an ellipsoid, kept apart."""
    best = rng.normal(size=(6000, 3))
    best[:, 2] = np.abs(best[:, 2])
    best /= np.linalg.norm(best, axis=1, keepdims=True)
    chosen = [0]
    distance = np.linalg.norm(best - best[0], axis=1)
    for _ in range(count - 1):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(best - best[chosen[-1]], axis=1))
    return best[chosen] * [75, 100, 70] + [0, 1500, 0]


def _skin_motion(rng, rest, rigid, frames, rate) -> np.ndarray:
    regions = rest[rng.choice(np.setdiff1d(np.arange(len(rest)), rigid), 16, replace=False)]
    reach = np.exp(-((np.linalg.norm(rest[:, None] - regions, axis=2) / 28) ** 2))
    reach[list(rigid)] = 0
    drive = gaussian_filter1d(rng.standard_normal((frames, 16)), 0.12 * rate, axis=0)
    drive = np.tanh(2 * np.maximum(drive / drive.std(axis=0), 0))
    blink = np.zeros(frames)
    blink[rng.integers(0, frames, max(2, frames // 400))] = 1
    drive[:, 0] = np.minimum(1, gaussian_filter1d(blink, 0.035 * rate) * 0.035 * rate * 2.5)
    size = np.concatenate([[10.0], rng.uniform(3, 12, 15)])
    direction = rng.normal(size=(16, 3))
    direction *= (size / np.linalg.norm(direction, axis=1))[:, None]
    motion = np.einsum("fr,mr,ri->fmi", drive, reach, direction)
    return motion * (1 - 0.01 * np.linalg.norm(motion, axis=2, keepdims=True))  # skin stiffens


def _head_motion(rng, truth, frames, rate) -> np.ndarray:
    sway = gaussian_filter1d(rng.standard_normal((frames, 6)), 0.5 * rate, axis=0)
    sway /= sway.std(axis=0)
    turns = Rotation.from_rotvec(0.15 * sway[:, :3]).as_matrix()
    middle = np.array([0, 1450, 0])
    return np.einsum("fij,fmj->fmi", turns, truth - middle) + middle + 15 * sway[:, None, 3:]


def _draw_swaps(rng, rest, frames, rate, share) -> tuple[tuple[int, int, int, int], ...]:
    """Exchanges of neighbours, one after another, until `share` of the frames have one."""
    near = np.argsort(np.linalg.norm(rest[:, None] - rest, axis=2), axis=1)[:, 1:5]
    swaps, at = [], 10
    total = 0
    mean_pause = 0 if share == 0 else 0.6 * rate * (1 / share - 1)
    while share and at < frames - 30:
        at += int(rng.exponential(mean_pause)) + 2
        length = int(rng.uniform(0.2, 1.0) * rate)
        if at + length > frames - 5:
            break
        first = int(rng.integers(len(rest)))
        swaps.append((first, int(rng.choice(near[first])), at, at + length))
        total += length
        at += length
    return tuple(swaps)


def _draw_dropouts(rng, shape, rate, share) -> np.ndarray:
    visible = np.ones(shape, bool)
    while share and (~visible).mean() < share:
        start, marker = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
        visible[start : start + int(rng.exponential(0.25 * rate)) + 1, marker] = False
    return visible


def hold_head(captured: np.ndarray, head: Stabilization) -> np.ndarray:
    """Return captured markers without the head's motion."""
    return np.asarray(remove_motion(captured, alignment_of(head.head_motion)))
