"""Threads predict the next blocks, in order, few at a time."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest

from tests.model.synthetic import references_of, synthetic_face
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import MappedMarkers
from usdface.model.mapping.train import train_mapping
from usdface.steps.performance import map as predict_blocks

ROWS = 40


def blocks(positions: np.ndarray, taken: list[int]) -> Iterator[predict_blocks.MarkerSource]:
    for start in range(0, len(positions), ROWS):
        taken.append(start)
        part = positions[start : start + ROWS].astype(np.float32)
        seen = np.ones(part.shape[:2], dtype=bool)
        yield partial(MappedMarkers, part, seen, seen.astype(np.float32))


def test_what_comes_out_does_not_depend_on_how_many_solve_and_few_blocks_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    face = synthetic_face()
    chosen = np.arange(0, len(face.positions), 60)
    mapping = train_mapping(
        references_of(face, chosen), ranges=face.ranges, gram=face.gram, method="face_map"
    )
    found = []
    for workers in (1, 4):
        monkeypatch.setattr(predict_blocks, "MAX_WORKERS", workers)
        monkeypatch.setattr("os.cpu_count", lambda: 8)
        taken: list[int] = []
        rows = []
        for done, answer in enumerate(
            predict_blocks.predict_pipelined(mapping, blocks(face.positions, taken))
        ):
            assert len(taken) - done <= workers + predict_blocks.QUEUE_DEPTH
            rows.append(answer.weights)
        found.append(np.concatenate(rows))
    np.testing.assert_array_equal(found[0], found[1])
    broken = face.positions.copy()
    broken[500] = np.nan
    with pytest.raises(InputError, match="is not finite"):
        list(predict_blocks.predict_pipelined(mapping, blocks(broken, [])))
