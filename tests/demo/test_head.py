"""The head at rest: a mesh an animator accepts."""

import numpy as np
import pytest

from usdface.core.arrays import FloatArray
from usdface.demo import rig
from usdface.demo.half_cage import Mark
from usdface.demo.head import DemoHead, HeadPart, bare_head, lid_edge, lip_rim
from usdface.demo.sculpt import ACTOR, CHARACTER, head_form


def face_normals(points: FloatArray, faces: np.ndarray) -> FloatArray:
    corners = points[faces]
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])


def test_left_and_right_mirror_each_other_exactly(head: DemoHead) -> None:
    face = head.parts != HeadPart.HAIR
    mirrored = head.points[head.mirror] * (-1.0, 1.0, 1.0)
    np.testing.assert_array_equal(mirrored[face], head.points[face])
    np.testing.assert_array_equal(head.mirror[head.mirror], np.arange(len(head.points)))
    np.testing.assert_array_equal(head.colors[head.mirror], head.colors)


def test_the_head_is_finite_and_its_faces_have_area(head: DemoHead) -> None:
    assert np.all(np.isfinite(head.points))
    assert len(head.points) > 3000
    area = 0.5 * np.linalg.norm(face_normals(head.points, head.faces), axis=1)
    assert area.min() > 1e-4


def test_no_point_is_left_over(head: DemoHead) -> None:
    np.testing.assert_array_equal(np.unique(head.faces), np.arange(len(head.points)))


@pytest.mark.parametrize("style", [CHARACTER, ACTOR], ids=lambda style: style.name)
def test_the_face_looks_outwards_everywhere(style, request: pytest.FixtureRequest) -> None:
    head: DemoHead = request.getfixturevalue(style.name)
    form = head_form(style)
    outside = (head.marks[:, Mark.MOUTH_RING] > 1.5) & (head.marks[:, Mark.EYE_RING] > 2.5)
    outside &= (head.parts == HeadPart.SKIN) & (head.marks[:, Mark.NOSTRIL] < 1e-9)
    faces = head.faces[np.all(outside[head.faces], axis=1)]
    middles = head.points[faces].mean(axis=1)
    gradient = np.stack(
        [form(middles + 0.1 * a) - form(middles - 0.1 * a) for a in np.eye(3)], axis=1
    )
    normals = face_normals(head.points, faces)
    facing = np.einsum("ij,ij->i", normals, gradient)
    assert np.all(facing > 0.0)


def test_neighbouring_skin_faces_agree_on_which_side_is_out(head: DemoHead) -> None:
    """Every inner edge is walked in opposite directions by its two faces."""
    walks = np.stack([head.faces, np.roll(head.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert len(np.unique(walks, axis=0)) == len(walks)


def test_the_sculpted_skin_lies_on_its_form(head: DemoHead) -> None:
    on_form = (head.parts == HeadPart.SKIN) & (head.marks[:, Mark.SETTLE] > 0.95)
    distance = head_form(head.style)(head.points[on_form])
    assert np.percentile(np.abs(distance), 95) < 0.5


def test_eyelids_leave_a_gap_over_the_iris(head: DemoHead) -> None:
    upper = head.points[lid_edge(head.points, head.marks, upper=True)]
    lower = head.points[lid_edge(head.points, head.marks, upper=False)]
    x = head.style.eye.center[0]
    gap = np.interp(x, upper[:, 0], upper[:, 1]) - np.interp(x, lower[:, 0], lower[:, 1])
    assert 8.0 < gap < 26.0


def test_lips_are_separate_along_the_slit_and_touch_at_rest(head: DemoHead) -> None:
    upper = lip_rim(head.points, head.marks, upper=True)
    lower = lip_rim(head.points, head.marks, upper=False)
    assert not set(upper) & set(lower)
    x = head.points[upper, 0]
    inner = np.abs(x) < 0.9 * head.style.mouth.half_width
    bottom = np.interp(x, head.points[lower, 0], head.points[lower, 1])
    gap = (head.points[upper, 1] - bottom)[inner]
    assert np.all(gap > -0.05)
    assert np.all(gap < 0.4)


def test_nothing_of_the_skin_enters_the_eyeball_at_rest(head: DemoHead) -> None:
    assert eyeball_clearance(head, head.points) > 0.0


def eyeball_clearance(head: DemoHead, points: FloatArray) -> float:
    """Least distance between the left eyeball and skin, lashes left out [mm]."""
    skin = (head.parts == HeadPart.SKIN) & (head.points[:, 0] > 0.0)
    offset = points[skin] - head.style.eye.center
    return float(np.linalg.norm(offset, axis=1).min() - head.style.eye.radius)


def test_the_two_people_differ(character: DemoHead, actor: DemoHead) -> None:
    assert np.abs(character.points - actor.points).max() > 5.0


def test_building_twice_gives_the_same_head() -> None:
    other = rig.bare_head(CHARACTER)  # of the first process of this run that asked for it
    np.testing.assert_array_equal(bare_head(CHARACTER).points, other.points)
