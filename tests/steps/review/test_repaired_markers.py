"""Markers that cleaning repaired look other than those that were measured."""

import numpy as np

from usdface.core.assets import Markers
from usdface.steps.review.pictures import repaired_markers


def test_a_marker_is_repaired_where_it_was_filled_or_moved() -> None:
    positions = np.zeros((3, 4, 3), np.float32)
    visible, confidence = np.ones((3, 4), bool), np.ones((3, 4), np.float32)
    visible[1, 0] = False  # filled
    confidence[1, 2] = 0.4  # moved
    markers = Markers(("a", "b", "c", "d"), positions, visible, confidence)
    assert repaired_markers(markers, 1).tolist() == [True, False, True, False]
    assert not repaired_markers(markers, 0).any()
