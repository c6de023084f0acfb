import numpy as np
import pytest

from usdface.media.face.markers_view import draw_markers, frame_markers

CLOUD = np.array([[-40.0, 30, 0], [40, 30, 0], [0, -50, 30]])


def marked(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - np.median(picture, axis=1, keepdims=True)).max(axis=2) > 25


def test_dots_lie_where_the_markers_project() -> None:
    frame = frame_markers(CLOUD)
    picture = draw_markers(CLOUD, width=400, height=400, frame=frame)
    found = marked(picture)
    scale = 400 / frame.height
    for x, y, _ in CLOUD - frame.center:
        column, row = int(200 + x * scale), int(200 - y * scale)
        assert found[row - 1 : row + 2, column - 1 : column + 2].all()
    assert found.sum() < 700


def test_nearer_markers_are_brighter() -> None:
    cloud = np.array([[-20.0, 0, -30], [20, 0, 30]])
    picture = draw_markers(cloud, width=160, height=120, frame=frame_markers(cloud))
    assert picture[:, 80:].max() > picture[:, :80].max() + 40


def test_unseen_markers_are_hollow() -> None:
    frame = frame_markers(CLOUD)
    seen = draw_markers(CLOUD, width=400, height=400, frame=frame)
    hidden = draw_markers(CLOUD, width=400, height=400, frame=frame, visible=[True, True, False])
    row, column = 200 + int((CLOUD[2, 1] - frame.center[1]) * -400 / frame.height), 200
    assert marked(seen)[row, column]
    assert not marked(hidden)[row, column]
    assert marked(hidden).sum() > 0


def test_a_stray_sample_does_not_shrink_the_face() -> None:
    cloud = np.random.default_rng(0).normal(0, 40, (200, 50, 3))
    stray = cloud.copy()
    stray[3, 4] = 9e4
    assert frame_markers(stray).height == pytest.approx(frame_markers(cloud).height, rel=0.05)


def test_dots_of_a_dense_cloud_leave_room_between_them() -> None:
    at = np.zeros((30, 3))
    at[:, 0] = np.arange(30)
    at[0, 1], at[-1, 1] = 20.0, -20.0
    picture = draw_markers(at, width=240, height=240).astype(int)
    inner = np.abs(picture - picture[100, 0]).max(axis=2)[120] > 60
    assert np.count_nonzero(np.diff(inner.astype(int)) == 1) == 28, "each dot by itself"
