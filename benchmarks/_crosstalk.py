"""Crosstalk of proposals: motion outside the part of the face that a take moves.

Proposals are compared with the plain solve, which has no costs of shapes and always enlarges blinks
until the lids close.
"""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers, set_up_equation
from usdface.numerics.measure.face_regions import points_by_region, region_gram
from usdface.numerics.registration.virtual_markers import character_motion
from usdface.numerics.solve.peak_matching import match_peaks

FOLDS = 5
STEP = 4
"""Every n-th frame is used for the error at left-out markers."""

Moving = tuple[str, ...]
"""Regions of a rig that a take moves."""


def print_crosstalk(
    takes: dict[str, tuple[FloatArray, tuple[str, ...], Moving]], rigs: dict[str, Rig]
) -> None:
    """Print a table of the takes on the rigs.

    Parameters
    ----------
    takes : dict of str to (positions, labels, moving)
        Stabilised positions [mm]; the first frame is neutral.
    """
    print("\n### Proposed weights: motion outside the moving parts, one-eyed closing, prediction\n")
    print(
        "Share of the squared surface motion; 95th percentile of the difference of the blinks; "
        "error at a fifth of the markers, left out, over that of no motion (five folds).\n"
    )
    print("| take, rig | solve | outside | one-eyed | left out |\n|---|---|---|---|---|")
    for rig_name, rig in rigs.items():
        deformer = Deformer(rig)
        for take_name, (positions, labels, moving) in takes.items():
            equation = set_up_equation(
                rig,
                deformer,
                PerformerMarkers(
                    neutral=positions[0],
                    positions=positions,
                    visible=np.ones(positions.shape[:2], bool),
                    rigid=(),
                    labels=labels,
                ),
            )
            for label, each in (("plain", _plain(equation, positions)), ("proposal", equation)):
                weights = each.propose(positions)
                outside = _outside(weights, rig, deformer, moving)
                blinks = [i for i, name in enumerate(rig.shapes) if name.lower().startswith("eyeb")]
                one_eyed = np.quantile(np.abs(np.ptp(weights[:, blinks], axis=1)), 0.95)
                left_out = _left_out(each, positions[::STEP])
                print(
                    f"| {take_name}, {rig_name} | {label} | {outside:.0%} | {one_eyed:.2f} | "
                    f"{left_out:.3f} |",
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


def _outside(weights: FloatArray, rig: Rig, deformer: Deformer, moving: Moving) -> float:
    offsets = deformer.shapes.key_offsets
    regions = points_by_region(deformer.shapes.target_offsets(), rig.shapes)
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
