import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.synthetic import RIGID, align_markers, markers_of, references_of, synthetic_face
from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import find_head_space
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping

pytestmark = pytest.mark.usefixtures("without_comparison")


def trained() -> TrainedMapping:
    face = synthetic_face()
    return train_mapping(
        references_of(face, np.arange(0, 1200, 30)),
        ranges=face.ranges,
        gram=face.gram,
        method="ridge",
    )


def test_a_take_in_another_head_space_is_moved_back() -> None:
    other = synthetic_face(noise=0.1)
    turn = Rotation.from_euler("xyz", [8, -12, 4], degrees=True).as_matrix()
    moved = other.positions @ turn.T + [30.0, -20.0, 5.0]
    mapped = align_markers(
        trained(), markers_of(other, positions=moved.astype(np.float32)), rate=60.0
    )
    np.testing.assert_allclose(mapped.positions, other.positions, atol=0.1)
    weights = WeightPredictor(trained()).predict(mapped.positions, visible=mapped.visible).weights
    assert np.sqrt(((weights - other.weights) ** 2).mean()) < 0.02


def test_markers_are_matched_by_name_in_any_order() -> None:
    face = synthetic_face()
    order = np.random.default_rng(0).permutation(len(face.names))
    shuffled = markers_of(
        face,
        names=(*(face.names[i] for i in order), "nose_extra"),
        positions=np.concatenate([face.positions[:, order], face.positions[:, :1]], axis=1).astype(
            np.float32
        ),
        visible=np.ones((1200, 25), dtype=bool),
        confidence=np.ones((1200, 25), dtype=np.float32),
    )
    mapped = align_markers(trained(), shuffled, rate=60.0)
    np.testing.assert_allclose(mapped.positions, face.positions, atol=0.02)
    space = find_head_space(face_of_mapping(trained()), shuffled, rate=60.0)
    assert (space.missing, space.extra) == ((), ("nose_extra",))


def test_another_calibration_is_told_from_markers_that_were_put_on_again() -> None:
    face = synthetic_face()
    larger = markers_of(face, positions=(1.02 * face.positions).astype(np.float32))
    space = find_head_space(face_of_mapping(trained()), larger, rate=60.0)
    assert space.scale == pytest.approx(1.02, abs=1e-3)
    shift = 0.8 * np.random.default_rng(1).standard_normal(face.positions.shape[1:])
    again = markers_of(face, positions=(face.positions + shift).astype(np.float32))
    assert find_head_space(face_of_mapping(trained()), again, rate=60.0).scale == 1.0


def test_missing_markers_are_marked_unseen() -> None:
    face = synthetic_face()
    kept = [i for i in range(len(face.names)) if i not in (9, 14)]
    fewer = markers_of(
        face,
        names=tuple(face.names[i] for i in kept),
        positions=face.positions[:, kept].astype(np.float32),
        visible=np.ones((1200, 22), dtype=bool),
        confidence=np.ones((1200, 22), dtype=np.float32),
    )
    mapped = align_markers(trained(), fewer, rate=60.0)
    assert find_head_space(face_of_mapping(trained()), fewer, rate=60.0).missing == ("m09", "m14")
    assert not mapped.visible[:, [9, 14]].any()
    prediction = WeightPredictor(trained()).predict(mapped.positions, visible=mapped.visible)
    assert np.sqrt(((prediction.weights - face.weights) ** 2).mean()) < 0.03


def test_a_repaired_sample_is_used_and_a_lost_one_is_not() -> None:
    face = synthetic_face()
    visible = np.ones((1200, 24), dtype=bool)
    confidence = np.ones((1200, 24), dtype=np.float32)
    visible[10:20, 8] = False
    confidence[10:15, 8] = 0.6
    confidence[15:20, 8] = 0.0
    mapped = align_markers(
        trained(), markers_of(face, visible=visible, confidence=confidence), rate=60.0
    )
    assert mapped.visible[10:15, 8].all()
    assert not mapped.visible[15:20, 8].any()


def test_one_slipped_rigid_marker_does_not_turn_the_head() -> None:
    face = synthetic_face()
    slipped = face.positions.copy()
    slipped[:, 2] += [0.0, 9.0, 0.0]
    mapped = align_markers(
        trained(), markers_of(face, positions=slipped.astype(np.float32)), rate=60.0
    )
    rest = np.delete(np.arange(24), 2)
    np.testing.assert_allclose(mapped.positions[:, rest], face.positions[:, rest], atol=0.5)


@pytest.mark.parametrize("loose", [False, True])
def test_frames_stabilised_by_other_markers_are_aligned_by_the_mappings(loose: bool) -> None:
    face, rng = synthetic_face(), np.random.default_rng(0)
    turns = np.cumsum(rng.normal(0, 0.004, (1200, 3)), axis=0)  # as if those had followed the skin
    moved = np.einsum("fij,fmj->fmi", Rotation.from_rotvec(turns).as_matrix(), face.positions)
    if loose:
        moved[:, 2] += np.cumsum(rng.normal(0, 1, (1200, 3)), axis=0)
    visible = np.ones((1200, len(face.names)), dtype=bool)
    visible[600:610, : RIGID - 2] = False
    markers = markers_of(
        face,
        positions=moved.astype(np.float32),
        visible=visible,
        confidence=visible.astype(np.float32),
        rigid=face.names[-6:],
    )
    space = find_head_space(face_of_mapping(trained()), markers, rate=60.0)
    placed = space.place(markers)
    away = (placed.positions - face.positions)[:, RIGID:]
    away -= np.median(away, axis=0)
    aligned = np.delete(np.arange(1200), np.arange(600, 610))
    assert np.abs(away[aligned]).max() < 0.1
    part = replace(
        markers,
        positions=markers.positions[300:400],
        visible=visible[300:400],
        confidence=markers.confidence[300:400],
    )
    np.testing.assert_allclose(space.place(part).positions, placed.positions[300:400], atol=1e-4)


def test_takes_that_cannot_be_mapped_say_what_to_do() -> None:
    face, mapping = synthetic_face(), trained()
    with pytest.raises(InputError, match="still holds head motion; run the clean step"):
        align_markers(mapping, markers_of(face, space="captured"), rate=60.0)
    renamed = tuple(f"x{i}" for i in range(24))
    with pytest.raises(InputError, match="has 0 of the mapping's 24 markers, at least 12"):
        align_markers(mapping, markers_of(face, names=renamed), rate=60.0)
    inches = face.positions * 25.4
    with pytest.raises(InputError, match=r"25.4 times those of .* another unit; .*--units"):
        align_markers(mapping, markers_of(face, positions=inches.astype(np.float32)), rate=60.0)
    larger = face.positions * 1.6  # no unit is
    with pytest.raises(InputError, match=r"distance is 1.6 times .* 0.625 times its --scale") as no:
        align_markers(mapping, markers_of(face, positions=larger.astype(np.float32)), rate=60.0)
    assert re.search(
        "mm from those of the takes it is compared with .*another performer: select and train",
        str(no.value),
    )
    moved = np.random.default_rng(3).normal(0, 20, (24, 3))
    stranger = (face.positions + moved).astype(np.float32)
    with pytest.raises(InputError, match=r"compared with.*; it is another marker set or"):
        align_markers(mapping, markers_of(face, positions=stranger), rate=60.0)


def test_a_mapping_without_its_arrays_asks_to_be_trained_again() -> None:
    face, mapping = synthetic_face(), trained()
    arrays = {k: v for k, v in mapping.arrays.items() if k != "motion_mean"}
    with pytest.raises(InputError, match="lacks the array 'motion_mean'; train it again"):
        WeightPredictor(replace(mapping, arrays=arrays)).predict(face.positions[:2])


@pytest.mark.parametrize("kept", [2, 0])
def test_the_face_aligns_a_take_with_too_few_rigid_markers(kept: int) -> None:
    other, turn = synthetic_face(noise=0.1, seed=1), Rotation.from_rotvec([0.2, -0.1, 0.1])
    fewer = tuple(f"x{i}" if kept <= i < RIGID else other.names[i] for i in range(24))
    moved = (turn.apply(other.positions.reshape(-1, 3)) + 20).reshape(other.positions.shape)
    markers = markers_of(other, names=fewer, positions=moved.astype(np.float32))
    mapped = align_markers(trained(), markers, rate=60.0)
    away = (mapped.positions - other.positions)[:, RIGID:]
    assert np.sqrt((away**2).sum(axis=2).mean()) < 0.3


def test_rigid_markers_that_were_applied_again_do_not_move_the_face() -> None:
    other = synthetic_face(noise=0.1, seed=1)
    moved = other.positions.copy()
    moved[:, :RIGID] += np.random.default_rng(0).normal(0, 9, (RIGID, 3))
    markers = markers_of(other, positions=moved.astype(np.float32))
    space = find_head_space(face_of_mapping(trained()), markers, rate=60.0)
    assert space.moved_mm > 5
    away = space.move(markers.positions, markers.visible)[:, RIGID:] - other.positions[:, RIGID:]
    assert np.sqrt((away**2).sum(axis=2).mean()) < 0.3


def test_the_face_aligns_a_take_whose_rigid_markers_are_on_a_line() -> None:
    face = synthetic_face()
    neutral = face.neutral.copy()
    neutral[:4] = np.outer([-50, -20, 10, 50], [0.8, 0.6, 0.0]) + np.array([0, 60, 10])
    face = replace(face, neutral=neutral, positions=face.positions - face.neutral + neutral)
    mapping = train_mapping(
        references_of(face, np.arange(0, 1200, 30)), ranges=face.ranges, gram=None, method="ridge"
    )
    turned = face.positions @ Rotation.from_rotvec([0.08, 0.06, 0.0]).as_matrix().T
    whole = markers_of(face, positions=turned.astype(np.float32))
    found = align_markers(mapping, whole, rate=60.0)
    np.testing.assert_allclose(found.positions, face.positions, atol=0.05)
    lacking = np.ones((1200, len(face.names)), dtype=bool)
    lacking[:, 4] = False  # the one rigid marker beside the line
    line = markers_of(
        face,
        positions=turned.astype(np.float32),
        visible=lacking,
        confidence=lacking.astype(np.float32),
    )
    found = align_markers(mapping, line, rate=60.0)
    np.testing.assert_allclose(found.positions[:, RIGID:], face.positions[:, RIGID:], atol=0.3)


def test_places_where_a_rigid_marker_was_last_seen_do_not_count() -> None:
    mapping = face_of_mapping(trained())
    frames, usable = mapping.frames.copy(), mapping.usable.copy()
    frames[: 3 * len(frames) // 5, :3] += [0.0, 6.0, 0.0]
    usable[: 3 * len(frames) // 5, :3] = False
    lost = replace(mapping, frames=frames, usable=usable)
    short = synthetic_face(frames=300)  # too short for an offset, which would correct the space
    space = find_head_space(lost, markers_of(short), rate=60.0)
    np.testing.assert_allclose(space.rotation, np.eye(3), atol=1e-3)
    np.testing.assert_allclose(space.shift, 0.0, atol=0.05)


@pytest.mark.parametrize("shown", [0, 2])
def test_a_take_that_shows_too_few_markers_is_refused(shown: int) -> None:
    face = synthetic_face()
    visible = np.zeros((1200, len(face.names)), dtype=bool)
    visible[:, :shown] = True
    markers = markers_of(face, visible=visible, confidence=visible.astype(np.float32))
    with pytest.raises(InputError, match=rf"have {shown} markers in common that are ever seen"):
        find_head_space(face_of_mapping(trained()), markers, rate=60.0)


def test_reapplied_markers_are_known_less_the_less_they_move() -> None:
    other = synthetic_face(noise=0.1, seed=1)
    away = np.random.default_rng(0).normal(0, 1.2, other.neutral.shape)
    away[: len(other.rigid)] = 0
    mapping, moved = trained(), (other.positions + away).astype(np.float32)
    known = align_markers(mapping, markers_of(other, positions=moved), rate=60.0).confidence[0]
    assert (align_markers(mapping, markers_of(other), rate=60.0).confidence == 1).all()
    motion = ((face_of_mapping(mapping).frames - mapping.neutral) ** 2).sum(axis=2).mean(axis=0)
    assert (known < 1).all()
    assert (np.argsort(known, kind="stable") == np.argsort(motion, kind="stable"))[-5:].all()


def test_a_mirrored_take_is_called_so_though_its_rigid_markers_are_elsewhere() -> None:
    made = synthetic_face()
    mirrored = replace(made, positions=made.positions * [-1, 1, 1], rigid=made.names[:12])
    face = replace(face_of_mapping(trained()), rigid=mirrored.rigid)
    with pytest.raises(InputError, match=r"mirror image .*--mirrored axes"):
        find_head_space(face, markers_of(mirrored), rate=60.0)


@pytest.mark.parametrize("frames", [slice(None), slice(200, 700)])
def test_positions_of_hidden_markers_may_be_anything(frames: slice) -> None:
    face, moved = synthetic_face(), synthetic_face(seed=3)
    visible = np.ones(moved.positions.shape[:2], bool)
    visible[frames, RIGID + 2] = False
    spaces = []
    for value in (0.0, np.nan):
        positions = moved.positions.astype(np.float32)
        positions[~visible] = value
        markers = markers_of(
            face, positions=positions, visible=visible, confidence=visible.astype(np.float32)
        )
        spaces.append(find_head_space(face_of_mapping(trained()), markers, rate=60.0))
    np.testing.assert_array_equal(spaces[0].neutral.offset, spaces[1].neutral.offset)
    np.testing.assert_array_equal(spaces[0].rotation, spaces[1].rotation)
    assert spaces[0].neutral.offset_mm == spaces[1].neutral.offset_mm
