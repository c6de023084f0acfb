"""What a rig's shapes should do to a performer's markers, learned from tuned pairs.

A pair shows how every marker lies when the rig's weights are known. A marker belongs to the piece
of skin that, under those weights, would move as it does: no registration, no landmarks. Shapes
that the pairs hardly use, or use only together, then still have a direction of motion: the rig's.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_GAINS = (0.4, 2.5)  # how much further or less far than the rig a performer's skin may go
_GAIN_DOUBT = 0.35  # standard deviation of the gain's logarithm
_NOISE_MM = 0.4  # what a marker moves for no reason
_MODEL_ERROR = 0.15  # of a marker's motion, which no place on another face explains
_EVIDENCE = 24.0  # independent samples that the pairs count for: faces repeat each other
_ROUNDS = 3
_MOST = 0.97  # quantile of points, by motion, that two faces are compared in size by


@dataclass(frozen=True)
class SkinPrior:
    """Expected motion of markers.

    Attributes
    ----------
    basis : (s, markers, 3) float array
        What each shape at 1 does to each marker, in the markers' space [mm].
    rotation : (3, 3) float array
        From the rig's space to the markers'.
    explained : float
        Share of the markers' motion energy in the pairs that the best places explain.
    """

    basis: FloatArray
    rotation: FloatArray
    explained: float


def expect_marker_motion(skin: FloatArray, weights: FloatArray, markers: FloatArray) -> SkinPrior:
    """Find for every marker the skin that moves as it does.

    Every point of the skin is a candidate, with a gain of its own; candidates are averaged by
    how well they explain the marker. The rotation between the spaces is found on the way. A rig
    of another size than any performer is brought to the performer's first.

    Parameters
    ----------
    skin : (s, points, 3) float array
        Displacement of points of the rig's surface by each shape at 1 [mm].
    weights : (pairs, s) float array
    markers : (pairs, markers, 3) float array
        [mm]

    Raises
    ------
    ValueError
        If the arrays do not fit together.
    """
    if skin.ndim != 3 or skin.shape[2] != 3 or skin.shape[0] != weights.shape[1]:
        raise ValueError(f"skin {skin.shape} and weights {weights.shape} do not fit together")
    if markers.shape[0] != len(weights):
        raise ValueError(f"{markers.shape[0]} marker clouds but {len(weights)} weights")
    seen = (markers - markers.mean(axis=0)).transpose(1, 0, 2)
    flat = (weights - weights.mean(axis=0)) @ skin.reshape(len(skin), -1)
    moved = np.ascontiguousarray(flat.reshape(len(weights), -1, 3).transpose(1, 0, 2))
    energy = np.einsum("mnc,mnc->m", seen, seen)
    size = np.einsum("pnc,pnc->p", moved, moved)
    scale = _size_of_performer(energy, size)
    skin, moved, size = skin * scale, moved * scale, size * scale**2
    values = 3 * len(weights)
    doubt = _NOISE_MM**2 + _MODEL_ERROR**2 * energy[:, None] / values
    rotation = np.eye(3)
    for turn in range(_ROUNDS):
        turned = moved @ rotation.T
        product = seen.reshape(len(seen), -1) @ turned.reshape(len(turned), -1).T
        gain = np.clip(product / np.maximum(size, 1e-9), *_GAINS)
        left = energy[:, None] - 2 * gain * product + gain**2 * size
        belief = -0.5 * _EVIDENCE * left / values / doubt
        belief -= 0.5 * (np.log(gain) / _GAIN_DOUBT) ** 2
        best = belief.argmax(axis=1)
        if turn < _ROUNDS - 1:
            own = gain[np.arange(len(best)), best]
            rotation = _rotation(moved[best] * own[:, None, None], seen)
    belief -= belief.max(axis=1, keepdims=True)
    share = np.exp(belief)
    share /= share.sum(axis=1, keepdims=True)
    basis = np.einsum("mp,spc->smc", share * gain, skin @ rotation.T, optimize=True)
    unexplained = left[np.arange(len(best)), best].sum() / max(float(energy.sum()), 1e-300)
    return SkinPrior(basis, rotation, float(1 - unexplained))


def _size_of_performer(seen: FloatArray, moved: FloatArray) -> float:
    """Scale that brings a rig's motion to the markers'; 1 where points' own gains reach it."""
    usual = float(np.quantile(moved, _MOST)) if len(moved) else 0.0
    wanted = float(np.quantile(seen, _MOST)) if len(seen) else 0.0
    if usual == 0 or wanted == 0:
        return 1.0
    scale = float(np.sqrt(wanted / usual))
    return 1.0 if _GAINS[0] <= scale <= _GAINS[1] else scale


def _rotation(rows: FloatArray, targets: FloatArray) -> FloatArray:
    """Proper rotation that turns displacements onto others best (Kabsch, without centring)."""
    cross = np.einsum("mni,mnj->ij", rows, targets)
    left, _, right = np.linalg.svd(cross)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    rotation: FloatArray = right.T @ flip @ left.T
    return rotation
