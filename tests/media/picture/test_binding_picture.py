"""The picture of a binding: every marker where it is, no name on another."""

import numpy as np
import pytest

from tests.small_scan import small_scan
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.media.picture.binding_picture import BoundMarkers, draw_binding

ORANGE = np.array([255, 128, 72])


def test_doubtful_markers_are_marked_and_the_sure_ones_are_not() -> None:
    scan = small_scan()
    mesh = RigMesh("/scan", scan.points, scan.counts, scan.indices)
    at = scan.points[scan.markers]

    def orange(doubt: str) -> int:
        markers = BoundMarkers(scan.names, at, (doubt,) * len(at), np.zeros(len(at), bool))
        picture = draw_binding([mesh], markers, title="test", quality="draft")
        return int((np.abs(picture.astype(int) - ORANGE).max(axis=2) < 12).sum())

    # The key shows one orange dot in either picture.
    assert orange("0.2") > orange("") + 200


def test_a_binding_without_markers_is_refused() -> None:
    scan = small_scan()
    mesh = RigMesh("/scan", scan.points, scan.counts, scan.indices)
    nobody = BoundMarkers((), np.zeros((0, 3)), (), np.zeros(0, bool))
    with pytest.raises(InputError, match="no marker to draw"):
        draw_binding([mesh], nobody, title="test")
