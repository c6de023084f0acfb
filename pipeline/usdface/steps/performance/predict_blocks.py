"""Blocks of frames predicted while earlier ones are written, with a fixed or a keyed blend."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import tee
from pathlib import Path

import numpy as np

from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import MappedMarkers
from usdface.model.mapping.predict import Prediction, WeightPredictor
from usdface.steps.inputs.weight_tables import read_alpha

MAX_WORKERS = 4
"""Threads: the one that writes keeps no more of them busy."""

Block = Callable[[], MappedMarkers]
"""Brings the markers of some frames into the mapping's space, in the thread that predicts them."""

QUEUE_DEPTH = 2
"""Blocks, beside those being predicted, that wait to be written: memory stays bounded."""


def predict_pipelined(mapping: TrainedMapping, blocks: Iterator[Block]) -> Iterator[Prediction]:
    """Yield the prediction of each block, in order, while threads predict the next ones.

    Arithmetic on arrays leaves Python free, and writing samples is Python: threads do both at
    once. What comes out does not depend on who is faster, nor on how many there are.
    """
    predictor = WeightPredictor(mapping)

    def predict(block: Block) -> Prediction:
        markers = block()
        return predictor.predict(markers.positions, visible=markers.visible)

    workers = min(MAX_WORKERS, os.cpu_count() or 1)
    with ThreadPoolExecutor(max_workers=workers, thread_name_prefix="predict") as pool:
        under_way: deque[Future[Prediction]] = deque()
        for block in blocks:
            under_way.append(pool.submit(predict, block))
            if len(under_way) >= workers + QUEUE_DEPTH:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()


def check_blend(path: Path, mapping: TrainedMapping) -> None:
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


def predict_with_keyed_blend(
    mapping: TrainedMapping, placed: Iterator[Block], alpha: Path, blocks: list[range]
) -> Iterator[Prediction]:
    """Yield the prediction of each block, with the share that `alpha` keys at each frame.

    Both parts are predicted, which takes twice the time of a constant blend.
    """
    keyed = [read_alpha(alpha, np.arange(block.start, block.stop)) for block in blocks]
    parts = [
        predict_pipelined(replace(mapping, settings=mapping.settings | {"alpha": share}), each)
        for share, each in zip((1.0, 0.0), tee(placed), strict=True)
    ]
    for share, network, regression in zip(keyed, *parts, strict=True):
        blend = share[:, None] * network.weights + (1 - share[:, None]) * regression.weights
        yield replace(regression, weights=blend)
