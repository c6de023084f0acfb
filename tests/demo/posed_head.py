"""Poses of a demo head, with in-betweens as in UsdSkel."""

from collections.abc import Mapping

import numpy as np

from usdface.demo.head import DemoHead


def posed(head: DemoHead, weights: Mapping[str, float]) -> np.ndarray:
    """Return the points for weights of shapes."""
    moved = head.points.copy()
    for name, weight in weights.items():
        keys = ((0.0, np.zeros_like(head.points)), *head.shapes[name])
        upper = next((k for k in range(1, len(keys) - 1) if weight <= keys[k][0]), len(keys) - 1)
        (low, start), (high, stop) = keys[upper - 1], keys[upper]
        moved += start + (stop - start) * ((weight - low) / (high - low))
    return moved
