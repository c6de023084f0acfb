"""Crosstalk of proposals: motion outside the part of the face that a take moves.

Proposals are compared with the plain solve, which has no costs of shapes and always enlarges blinks
until the lids close.
"""

from dataclasses import replace

import numpy as np

from benchmarks._placement_subjects import Head
from usdface.core.arrays import FloatArray
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.numerics.measure.face_regions import points_by_region, region_gram
from usdface.numerics.registration.virtual_markers import character_motion
from usdface.numerics.solve.peak_matching import match_peaks

FOLDS = 5
STEP = 4
"""Every n-th frame is used for the error at left-out markers."""

Moving = tuple[str, ...]
"""Regions of a rig that a take moves."""


def print_crosstalk(
    equations: dict[tuple[str, str], BlendshapeEquation],
    positions: dict[str, FloatArray],
    moving: dict[str, Moving],
    heads: dict[str, Head],
) -> None:
    """Print a table of the equations, which are by rig and take.

    Parameters
    ----------
    positions : dict of str to (frames, markers, 3) array
        Stabilised positions of each take [mm].
    """
    print("\n### Proposed weights: motion outside the moving parts, one-eyed closing, prediction\n")
    print(
        "Share of the squared surface motion; 95th percentile of the difference of the blinks; "
        "error at a fifth of the markers, left out, over that of no motion (five folds).\n"
    )
    print("| take, rig | solve | outside | one-eyed | left out |\n|---|---|---|---|---|")
    for (rig, take), equation in equations.items():
        shapes = heads[rig].rig.shapes
        blinks = [i for i, name in enumerate(shapes) if name.lower().startswith("eyeb")]
        plain = _plain(equation, positions[take])
        for label, each in (("plain", plain), ("proposal", equation)):
            weights = each.propose(positions[take])
            outside = _outside(weights, heads[rig], moving[take])
            one_eyed = np.quantile(np.abs(np.ptp(weights[:, blinks], axis=1)), 0.95)
            left_out = _left_out(each, positions[take][::STEP])
            print(
                f"| {take}, {rig} | {label} | {outside:.0%} | {one_eyed:.2f} | {left_out:.3f} |",
                flush=True,
            )


def _plain(equation: BlendshapeEquation, positions: FloatArray) -> BlendshapeEquation:
    """Return the equation without costs of shapes, with blinks enlarged in any case."""
    shapes = () if equation.lids is None else equation.lids.shapes
    motion = character_motion(equation.virtual, positions, equation.neutral)
    gain = match_peaks(
        equation.deltas, motion, shapes, ranges=equation.ranges, marker_trust=equation.trust
    )
    return replace(equation, noise_mm=0.0, lids=None, gain=gain)


def _outside(weights: FloatArray, head: Head, moving: Moving) -> float:
    deformer = head.deformer
    offsets = deformer.shapes.key_offsets
    regions = points_by_region(deformer.shapes.target_offsets(), head.rig.shapes)
    keys = deformer.shapes.key_weights(weights)

    def moved(points: np.ndarray) -> float:
        gram = region_gram(offsets, points) * len(points)
        return float(np.einsum("fi,ij,fj->", keys, gram, keys, optimize=True))

    inside = sum(moved(regions[part]) for part in moving if part in regions)
    return 1 - inside / moved(np.arange(len(deformer.neutral)))


def _left_out(equation: BlendshapeEquation, positions: FloatArray) -> float:
    """Return the error at left-out markers, divided by that of a face at rest."""
    motion = character_motion(equation.virtual, positions, equation.neutral)
    order, off = np.random.default_rng(0).permutation(positions.shape[1]), 0.0
    for fold in range(FOLDS):
        hidden = order[fold::FOLDS]
        trust = equation.trust.copy()
        trust[hidden] = 0.0
        weights = replace(equation, trust=trust).propose(positions)
        keys = equation.keys.key_weights(weights)
        reached = np.einsum("fk,kmc->fmc", keys, equation.keys.deltas[:, hidden], optimize=True)
        off += float(((reached - motion[:, hidden]) ** 2).sum())
    return float(np.sqrt(off / (motion**2).sum()))
