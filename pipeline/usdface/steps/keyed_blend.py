"""A hybrid mapping whose blend is keyed over time: eq. 9 of Song et al. (2011) on markers."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import tee
from pathlib import Path

import numpy as np

from usdface.assets import Mapping
from usdface.errors import InputError
from usdface.model.predict import Prediction
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.steps.alpha_curve import read_alpha
from usdface.steps.solving import Block, solve_ahead


def check_blend(path: Path, mapping: Mapping) -> None:
    """Refuse to blend what has only one part.

    Raises
    ------
    InputError
        If the mapping is no hybrid.
    """
    if mapping.method != "hybrid":
        raise InputError(
            f"{path}: alpha blends the two parts of a hybrid, and this mapping is "
            f"{mapping.method}; train with --method hybrid"
        )


def solve_blended(
    mapping: Mapping,
    placed: Iterator[Block],
    alpha: Path,
    blocks: list[range],
    *,
    device: ArrayDevice = CPU,
) -> Iterator[Prediction]:
    """Yield the answer to each block, blended as `alpha` says at each of its frames.

    Both parts are solved on their own, so that this takes twice the time of a constant blend.
    """
    keyed = [read_alpha(alpha, np.arange(block.start, block.stop)) for block in blocks]
    parts = [
        solve_ahead(
            replace(mapping, settings=mapping.settings | {"alpha": share}), own, device=device
        )
        for share, own in zip((1.0, 0.0), tee(placed), strict=True)
    ]
    for share, network, regression in zip(keyed, *parts, strict=True):
        blend = share[:, None] * network.weights + (1 - share[:, None]) * regression.weights
        yield replace(regression, weights=blend)
