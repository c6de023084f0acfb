"""Solve one block of frames while the block before is written."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from usdface.assets import Mapping
from usdface.model.head_space import MappedMarkers
from usdface.model.predict import Prediction, predict_weights

AHEAD = 2
"""Blocks that wait to be written at most: memory stays bounded."""


def solve_ahead(mapping: Mapping, blocks: Iterator[MappedMarkers]) -> Iterator[Prediction]:
    """Yield a mapping's answer to each block, in order, the next ones under way meanwhile.

    Arithmetic on arrays leaves Python free, and writing samples is Python: two threads do both at
    once. What comes out does not depend on who is faster.
    """
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="solve") as solver:
        under_way: deque[Future[Prediction]] = deque()
        for block in blocks:
            under_way.append(
                solver.submit(predict_weights, mapping, block.positions, visible=block.visible)
            )
            if len(under_way) > AHEAD:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
