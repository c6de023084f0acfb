"""The picture of a binding: every marker where it is, no name on another."""

from unittest import mock

import numpy as np

from tests.small_scan import small_scan
from usdface.core.assets import RigMesh
from usdface.media.picture import binding_picture
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


def test_names_that_do_not_fit_are_left_out_except_those_to_look_at() -> None:
    scan = small_scan()
    mesh = RigMesh("/scan", scan.points, scan.counts, scan.indices)
    at = np.repeat(scan.points[scan.markers], 1 + 240 // len(scan.markers), axis=0)
    doubts = [""] * len(at)
    doubts[70] = "0.2"
    names = tuple(f"m{row}" for row in range(len(at)))
    markers = BoundMarkers(names, at, tuple(doubts), np.zeros(len(at), bool))
    with mock.patch.object(binding_picture, "_write_name", autospec=True) as write:
        draw_binding([mesh], markers, title="test", quality="draft")
    rows: dict[tuple[int, int], list[int]] = {}  # of each column
    for call in write.call_args_list:
        column = (id(call.args[0]), call.kwargs["x"])
        rows.setdefault(column, []).append(call.kwargs["row"])
    assert max(map(len, rows.values())) >= 40
    assert all(np.diff(column).min() >= 11 for column in rows.values() if len(column) > 1)
    assert 70 in [call.args[2] for call in write.call_args_list]
