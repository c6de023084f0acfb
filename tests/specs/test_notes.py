"""Notes of a review."""

import pytest

from usdface.specs.notes import ReviewNote


@pytest.mark.parametrize(
    ("frame", "last", "span"),
    [(-5, 0, (-5, 0)), (-5, -2, (-5, -2)), (0, None, (0, 0)), (7, 3, (7, 7))],
)
def test_a_note_spans_its_frames_also_up_to_frame_0(
    frame: int, last: int | None, span: tuple[int, int]
) -> None:
    assert ReviewNote(id="a", frame=frame, last=last).span == span
