"""Solve blocks of frames while those before are written."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from usdface.assets import Mapping
from usdface.model.head_space import MappedMarkers
from usdface.model.predict import Prediction, WeightPredictor
from usdface.numerics.array_namespace import CPU, ArrayDevice

MOST_SOLVERS = 4
"""Threads at most: one that writes keeps no more of them busy."""

Block = Callable[[], MappedMarkers]
"""Brings the markers of some frames into the mapping's space: the thread that solves them does."""

AHEAD = 2
"""Blocks beyond those being solved that wait to be written at most: memory stays bounded."""


def solve_ahead(
    mapping: Mapping, blocks: Iterator[Block], *, device: ArrayDevice = CPU
) -> Iterator[Prediction]:
    """Yield a mapping's answer to each block, in order, the next ones under way meanwhile.

    Arithmetic on arrays leaves Python free, and writing samples is Python: threads do both at
    once. What comes out does not depend on who is faster, nor on how many there are.
    """
    predictor = WeightPredictor(mapping, device=device)

    def solve(block: Block) -> Prediction:
        markers = block()
        return predictor.predict(markers.positions, visible=markers.visible)

    solvers = min(MOST_SOLVERS, os.cpu_count() or 1) if device is CPU else 1
    with ThreadPoolExecutor(max_workers=solvers, thread_name_prefix="solve") as pool:
        under_way: deque[Future[Prediction]] = deque()
        for block in blocks:
            under_way.append(pool.submit(solve, block))
            if len(under_way) >= solvers + AHEAD:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
