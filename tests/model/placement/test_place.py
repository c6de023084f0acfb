"""A performer's markers on a rig: by labels where they speak, else by symmetry and motion."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from tests.model.synthetic import skin_samples
from tests.numerics.simulated_face import hold_head
from tests.remembered import coarse_face_skin
from usdface.capture.sniff import read_capture
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.demo.sculpt import ACTOR
from usdface.model.placement.known_places import places_by_labels
from usdface.model.placement.label_hints import side_of_label, skin_motion_mm
from usdface.model.placement.marker_cloud import MarkerCloud, marker_cloud
from usdface.model.placement.place import MarkerPlacement, place_markers
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.face_skin import FaceSkin, sample_face_skin
from usdface.numerics.rigid.stabilization import stabilize_by_prior
from usdface.usdio.rig.read import read_rig


def skin_of(rig) -> FaceSkin:
    deformer = Deformer(rig)
    return sample_face_skin(deformer.neutral, deformer.triangles, deformer.shapes.target_offsets())


@cache
def head_of(file: Path) -> tuple[Rig, FaceSkin]:
    rig = read_rig(file)
    return rig, skin_of(rig)


@pytest.fixture(scope="module")
def demo():
    rig = demo_rig()
    return rig, skin_of(rig)


@pytest.fixture(scope="module")
def actor():
    rig = demo_rig(ACTOR)
    return rig, skin_of(rig)


@pytest.fixture(scope="module")
def coarse_demo():
    """The demo's character, for markers placed by their labels to within several samples."""
    rig = demo_rig()
    deformer = Deformer(rig)
    offsets = deformer.shapes.target_offsets()
    return rig, coarse_face_skin(deformer.neutral, deformer.triangles, offsets)


def test_landmarks_of_a_face_stand_in_the_order_of_a_face(demo) -> None:
    rig, skin = demo
    found = find_landmarks(skin, rig.shapes)
    down = ("brow_centre", "nose_bridge", "nose_tip", "lip_upper", "lip_lower", "chin")
    assert (np.diff([found[name][1] for name in down]) < 0).all()
    assert found["nose_tip"][2] > found["chin"][2]
    for name in ("mouth", "lid_upper", "eye_inner", "eye_outer", "brow_outer"):
        left, right = found[f"{name}_L"], found[f"{name}_R"]
        assert left[0] > skin.sagittal_x > right[0]
        np.testing.assert_allclose(skin.mirrored(right[None])[0], left, atol=1e-9)


@pytest.mark.fixtures("rigs")
@pytest.mark.parametrize("name", ["facecap_head", "ict_face", "demo_character"])
def test_the_mouth_is_where_a_person_sees_it(shared_data: Path, demo, name: str) -> None:
    seen = json.loads((shared_data / "rigs" / "landmarks.json").read_text("utf-8"))[name]
    own = name == "demo_character"
    rig, skin = demo if own else head_of(shared_data / "rigs" / f"{name}.usdc")
    found = find_landmarks(skin, rig.shapes)
    for corner in ("mouth_L", "mouth_R"):
        np.testing.assert_allclose(skin.from_frame(found[corner])[:2], seen[corner], atol=2.5)


def test_a_body_under_the_face_does_not_widen_the_mouth(demo) -> None:
    rig, skin = demo
    x, y = np.meshgrid(np.arange(-60.0, 60.0, 6.0), np.arange(10.0, 400.0, 6.0))
    low = skin.positions.min(axis=0)
    body = np.stack([x.ravel(), low[1] - y.ravel(), np.full(x.size, low[2])], axis=1)
    still = np.zeros((len(skin.deltas), len(body), 3), dtype=skin.deltas.dtype)
    whole = replace(
        skin,
        positions=np.vstack([skin.positions, body]),
        normals=np.vstack([skin.normals, np.tile([0.0, 0.0, 1.0], (len(body), 1))]),
        areas=np.append(skin.areas, np.ones(len(body))),
        deltas=np.concatenate([skin.deltas, still], axis=1),
    )
    found = find_landmarks(whole, rig.shapes)
    for name, place in find_landmarks(skin, rig.shapes).items():
        np.testing.assert_allclose(found[name], place, atol=1e-9)


def test_shapes_named_by_the_viewer_show_the_same_landmarks(demo) -> None:
    rig, skin = demo
    other = {"Left": "Right", "Right": "Left"}
    named = find_landmarks(skin, rig.shapes)
    exchanged = tuple(
        re.sub(r"(?<=[a-z])(Left|Right)$", lambda side: other[side[0]], name)
        if not name.startswith(("jaw", "mouthLeft", "mouthRight"))
        else name
        for name in rig.shapes
    )
    assert exchanged != rig.shapes
    found = find_landmarks(skin, exchanged)
    assert found.keys() == named.keys()
    for name, place in named.items():
        np.testing.assert_allclose(found[name], place, atol=1e-9)
    for motion in ("eyeBlink", "browOuterUp"):  # of one motion alone
        pair = {f"{motion}{side}": f"{motion}{other[side]}" for side in other}
        found = find_landmarks(skin, tuple(pair.get(name, name) for name in rig.shapes))
        for name, place in named.items():
            np.testing.assert_allclose(found[name], place, atol=1e-9)


def test_numbers_of_another_model_than_openfaces_name_no_landmark(demo) -> None:
    rig, skin = demo
    landmarks = find_landmarks(skin, rig.shapes)
    for count, known in ((68, True), (478, False)):  # OpenFace's, and MediaPipe's
        labels = tuple(f"landmark_{number}" for number in range(count))
        still = np.zeros((count, 3))
        cloud = marker_cloud(labels, still, still[None])
        assert bool(places_by_labels(cloud, landmarks)) == known


def test_sides_that_both_shapes_leave_still_have_no_landmark(demo) -> None:
    rig, skin = demo
    copied = skin.deltas.copy()
    for motion in ("browOuterUp", "mouthDimple"):
        left, right = (rig.shapes.index(f"{motion}{side}") for side in ("Left", "Right"))
        copied[right] = np.where((skin.positions[:, :1] > skin.sagittal_x), copied[left], 0.0)
        copied[left] = copied[right]
    found = find_landmarks(replace(skin, deltas=copied), rig.shapes)
    assert "brow_outer_L" in found
    assert "brow_outer_R" not in found
    hidden = [0.0 if name.startswith("jaw") else 1.0 for name in rig.shapes]  # the jaw is a joint
    without_jaw = replace(skin, deltas=copied * np.array(hidden)[:, None, None])
    assert "mouth_R" not in find_landmarks(without_jaw, rig.shapes)


def test_shapes_with_foreign_names_are_known_by_what_they_do(demo) -> None:
    rig, skin = demo
    named = find_landmarks(skin, rig.shapes)
    order = np.random.default_rng(0).permutation(len(rig.shapes))
    mixed = replace(skin, deltas=skin.deltas[order])
    found = find_landmarks(mixed, tuple(f"shape_{i}" for i in range(len(order))))
    for name in ("nose_tip", "chin", "mouth_L", "lid_upper_R", "lid_lower_L", "eye_outer_R"):
        np.testing.assert_allclose(found[name], named[name], atol=1e-9)
    assert "brow_inner_L" not in found


def test_a_jaw_with_a_foreign_name_is_known_among_named_shapes_of_the_mouth(demo) -> None:
    rig, skin = demo
    foreign = {"jawOpen": "mnd_abr", "eyeBlinkLeft": "parp_c_L", "eyeBlinkRight": "parp_c_R"}
    found = find_landmarks(skin, tuple(foreign.get(name, name) for name in rig.shapes))
    for name, place in find_landmarks(skin, rig.shapes).items():
        np.testing.assert_allclose(found[name], place, atol=1e-9, err_msg=name)


def test_an_eye_of_a_coarse_lid_is_found(demo) -> None:
    rig, skin = demo
    column, deltas = rig.shapes.index("eyeBlinkRight"), skin.deltas.copy()
    size = np.linalg.norm(deltas[column], axis=1)
    deltas[column, np.argsort(size)[:-1]] *= 0.75  # one sample is left on the margin
    assert "eye_inner_R" in find_landmarks(replace(skin, deltas=deltas), rig.shapes)


def test_a_corner_of_an_eye_far_from_the_other_samples_is_found(demo) -> None:
    rig, skin = demo
    column, deltas = rig.shapes.index("eyeBlinkLeft"), skin.deltas.copy()
    lid = np.argsort(np.linalg.norm(deltas[column], axis=1))[-45:]
    deltas[column] = 0.0
    deltas[column, lid, 1] = -9.0
    positions = skin.positions.copy()
    positions[lid, 1] = positions[lid, 1].mean()
    outermost = lid[positions[lid, 0].argmax()]
    positions[outermost, 0] += 25.0
    found = find_landmarks(replace(skin, deltas=deltas, positions=positions), rig.shapes)
    assert all(np.isfinite(place).all() for place in found.values())


@pytest.mark.parametrize("head", ["demo", "actor", "facecap_head", "ict_face"])
def test_a_mouth_whose_jaw_is_a_joint_is_found_from_its_lips(request, head: str) -> None:
    if head in ("demo", "actor"):
        rig, skin = request.getfixturevalue(head)
    else:
        rig, skin = head_of(request.getfixturevalue("shared_data") / "rigs" / f"{head}.usdc")
    kept = [i for i, name in enumerate(rig.shapes) if not name.startswith(("jaw", "mouthClose"))]
    names = tuple(rig.shapes[i] for i in kept)
    found = find_landmarks(replace(skin, deltas=skin.deltas[kept]), names)
    for name, place in find_landmarks(skin, rig.shapes).items():
        assert np.linalg.norm(found[name] - place) < 8, name


def test_lips_do_not_lie_on_the_nose(actor) -> None:
    rig, skin = actor
    found = find_landmarks(skin, rig.shapes)
    assert found["lip_upper"][1] - found["mouth_middle"][1] < 15


def test_a_rig_without_blinks_or_a_jaw_has_no_landmarks_rather_than_wrong_ones(demo) -> None:
    rig, skin = demo
    left_out = [i for i, name in enumerate(rig.shapes) if not name.startswith(("eye", "jaw"))]
    rest = replace(skin, deltas=skin.deltas[left_out])
    assert find_landmarks(rest, tuple(f"shape_{i}" for i in left_out)) == {}


@pytest.mark.parametrize("size", [0.1, 25.4])
def test_landmarks_are_at_the_same_features_of_a_rig_in_another_unit(demo, size: float) -> None:
    rig, skin = demo
    deformer = Deformer(rig)
    other = sample_face_skin(
        size * deformer.neutral, deformer.triangles, size * deformer.shapes.target_offsets()
    )
    found, scaled = find_landmarks(skin, rig.shapes), find_landmarks(other, rig.shapes)
    assert scaled.keys() == found.keys()
    away = [np.linalg.norm(scaled[name] - place) for name, place in found.items()]
    assert max(away) < 1e-3


def test_labels_put_another_performers_markers_on_their_features(demo) -> None:
    """Markers at the character's own landmarks, on a face of other proportions, turned away."""
    rig, skin = demo
    found = find_landmarks(skin, rig.shapes)
    labels = {
        "NoseTip": "nose_tip",
        "Chin": "chin",
        "Mouth_Lend": "mouth_L",
        "Mouth_Rend": "mouth_R",
        "Leye_Inner": "eye_inner_L",
        "Reye_Inner": "eye_inner_R",
        "Lbrow_Outer": "brow_outer_L",
        "Rbrow_Outer": "brow_outer_R",
    }
    places = np.array([found[name] for name in labels.values()])
    yaw = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    neutral = (places * [1.15, 0.9, 1.3]) @ yaw.T + [300.0, 1500.0, -80.0]
    cloud = marker_cloud(tuple(labels), neutral, neutral[None][:0])
    placed = place_markers(cloud, skin, rig.shapes)
    away = np.linalg.norm(skin.positions[skin_samples(skin, placed.virtual)] - places, axis=1)
    assert placed.by_labels
    assert away.max() < 5.0
    assert placed.virtual.motion_scale == pytest.approx(skin.unit / np.sqrt(1.15 * 0.9), rel=0.05)


def test_labels_place_markers_on_a_rig_with_foreign_names(demo) -> None:
    rig, skin = demo
    found = find_landmarks(skin, rig.shapes)
    labels = {
        "NoseTip": "nose_tip",
        "Chin": "chin",
        "Mouth_Lend": "mouth_L",
        "Mouth_Rend": "mouth_R",
        "Leye_Inner": "eye_inner_L",
        "Reye_Inner": "eye_inner_R",
        "Leye_Outer": "eye_outer_L",
        "Reye_Outer": "eye_outer_R",
    }
    places = np.array([found[name] for name in labels.values()])
    cloud = marker_cloud(tuple(labels), places * [1.1, 0.95, 1.2], places[None][:0])
    placed = place_markers(cloud, skin, tuple(f"shape_{i}" for i in range(len(rig.shapes))))
    assert placed.by_labels
    assert (
        np.linalg.norm(skin.positions[skin_samples(skin, placed.virtual)] - places, axis=1).max()
        < 5.0
    )


def numbered_labels(skin: FaceSkin, shapes, at) -> tuple[str, ...]:
    """Name markers by the part and the side that they are on, and by a number."""
    found = find_landmarks(skin, shapes)
    names, counts, labels = list(found), {}, []
    for place in at:
        away = np.linalg.norm(np.array(list(found.values())) - place, axis=1)
        near = names[away.argmin()].split("_")[0] if away.min() < 25 else "cheek"
        part = {"eye": "lid", "lip": "mouth"}.get(near, near)
        name = f"{part}_{'L' if place[0] > skin.sagittal_x else 'R'}"
        counts[name] = counts.get(name, 0) + 1
        labels.append(f"{name}{counts[name]}")
    return tuple(labels)


@pytest.mark.usefixtures("placed_once", "few_starts")
def test_numbered_labels_of_a_part_do_not_draw_its_markers_together(coarse_demo) -> None:
    """Nine markers of a brow are not at one landmark: the cloud keeps its size."""
    rig, skin = coarse_demo
    rng = np.random.default_rng(6)
    moving = np.flatnonzero(skin.activity() > 0.1 * skin.activity().max())
    chosen = rng.choice(moving, 60, replace=False)
    at = skin.positions[chosen]
    labels = numbered_labels(skin, rig.shapes, at)
    assert sum(label.startswith("mouth_L") for label in labels) > 2
    weights = np.zeros((80, len(rig.shapes)))
    for frame in weights[1:]:
        frame[rng.choice(len(rig.shapes), 4, replace=False)] = rng.random(4)
    moved = np.einsum("fs,smc->fmc", weights, skin.deltas[:, chosen])
    neutral = at * [1.1, 0.95, 1.2]
    cloud = marker_cloud(labels, neutral, neutral + moved)
    placed = place_markers(cloud, skin, rig.shapes)
    away = np.linalg.norm(skin.positions[skin_samples(skin, placed.virtual)] - at, axis=1)
    assert np.median(away) < 1.5
    assert placed.virtual.motion_scale == pytest.approx(skin.unit / np.sqrt(1.1 * 0.95), rel=0.08)


@pytest.mark.usefixtures("placed_once", "few_starts")
def test_numbered_labels_decide_where_the_rig_does_not_show_the_motion(coarse_demo) -> None:
    rig, skin = coarse_demo
    rng = np.random.default_rng(0)
    moving = np.flatnonzero(skin.activity() > 0.1 * skin.activity().max())
    at = skin.positions[rng.choice(moving, 40, replace=False)]
    moved = np.einsum("fm,mc->fmc", rng.random((12, 40)), 3 * rng.normal(size=(40, 3)))
    cloud = marker_cloud(numbered_labels(skin, rig.shapes, at), at, at + moved)
    placed = place_markers(cloud, skin, rig.shapes)
    assert not placed.by_labels
    away = np.linalg.norm(skin.positions[skin_samples(skin, placed.virtual)] - at, axis=1)
    assert np.median(away) < 18.0  # 60 by motion


def test_a_place_that_a_person_gave_is_kept(demo) -> None:
    rig, skin = demo
    found = find_landmarks(skin, rig.shapes)
    names = ("nose_tip", "chin", "mouth_L", "mouth_R", "lid_upper_L")
    places = np.array([found[name] for name in names])
    cloud = marker_cloud(tuple("abcde"), places, places[None][:0])
    pins = {row: skin.from_frame(place) for row, place in enumerate(places)}
    placed = place_markers(cloud, skin, rig.shapes, pinned=pins)
    away = np.linalg.norm(skin.positions[skin_samples(skin, placed.virtual)] - places, axis=1)
    assert away.max() < 3.0  # the distance between samples


FEATURES = {"nose": "NoseHead", "chin": "Chin", "mouth_L": "Mouth_Lend", "mouth_R": "Mouth_Rend"}


@cache
def recorded_cloud(shared_data, take: str) -> MarkerCloud:
    """Return a recorded take's markers, its head held still."""
    markers = read_capture(shared_data / "markers_animface" / f"{take}.c3d").take.markers
    head = stabilize_by_prior(
        markers.positions,
        markers.visible,
        skin_motion_mm=skin_motion_mm(markers.names),
        rate=60.0,
        neutral=0,
    )
    still = hold_head(markers.positions, head).astype(float)
    return marker_cloud(markers.names, still[0], still)


@cache
def recorded_placement(shared_data, take: str, head: str) -> MarkerPlacement:
    rig, skin = head_of(shared_data / "rigs" / f"{head}.usdc")
    return place_markers(recorded_cloud(shared_data, take), skin, rig.shapes)


@pytest.mark.parametrize(
    ("head", "take"),
    [
        pytest.param("facecap_head", "CheeksMoCap", marks=pytest.mark.slow),
        ("ict_face", "EyebrowsMoCap"),
    ],
)
def test_a_recorded_performer_sits_where_he_does_if_the_jaw_is_a_joint(
    shared_data, head: str, take: str
) -> None:
    cloud = recorded_cloud(shared_data, take)
    rig, skin = head_of(shared_data / "rigs" / f"{head}.usdc")
    kept = [i for i, name in enumerate(rig.shapes) if not name.startswith(("jaw", "mouthClose"))]
    without = replace(skin, deltas=skin.deltas[kept])
    placed = recorded_placement(shared_data, take, head)
    joint = place_markers(cloud, without, tuple(rig.shapes[i] for i in kept))
    away = np.linalg.norm(
        skin.positions[skin_samples(skin, placed.virtual)]
        - skin.positions[skin_samples(skin, joint.virtual)],
        axis=1,
    )
    assert np.median(away) < 3.5
    assert np.quantile(away, 0.9) < 8  # [mm]


@pytest.mark.parametrize("take", ["CheeksMoCap", "EyebrowsMoCap"])
@pytest.mark.parametrize("head", ["facecap_head", "ict_face"])
def test_a_recorded_performer_sits_right_on_any_head(shared_data, head: str, take: str) -> None:
    cloud = recorded_cloud(shared_data, take)
    _, skin = head_of(shared_data / "rigs" / f"{head}.usdc")
    placed = recorded_placement(shared_data, take, head)
    at = dict(zip(cloud.labels, skin.positions[skin_samples(skin, placed.virtual)], strict=True))
    picked = json.loads((shared_data / "rigs" / "landmarks.json").read_text())[head]
    away = {name: np.hypot(*(at[label][:2] - picked[name])) for name, label in FEATURES.items()}
    assert away["nose"] <= 4.5
    assert max(away.values()) <= 13.0  # this performer's chin and corners sit beside the features
    for side in "LR":
        assert at[f"{side}eye_Up"][1] >= picked[f"lidup_{side}"][1] - 0.5
    upward = at["ForeHead_M"] - at["Chin"]
    assert abs(np.degrees(np.arctan2(upward[0], upward[1]))) <= 2.0


@pytest.mark.parametrize("head", ["facecap_head", "ict_face"])
def test_labels_place_markers_of_one_side(shared_data, head: str) -> None:
    """Half of a recorded face is placed as in the whole; a reflection would pair its cheek."""
    markers = read_capture(shared_data / "markers_animface" / "EyebrowsMoCap.c3d").take.markers
    kept = [row for row, name in enumerate(markers.names) if side_of_label(name) != "R"]
    names = tuple(markers.names[row] for row in kept)
    motion = stabilize_by_prior(
        markers.positions[:, kept],
        markers.visible[:, kept],
        skin_motion_mm=skin_motion_mm(names),
        rate=60.0,
        neutral=0,
    )
    still = hold_head(markers.positions[:, kept], motion).astype(float)
    rig, skin = head_of(shared_data / "rigs" / f"{head}.usdc")
    placed = place_markers(marker_cloud(names, still[0], still), skin, rig.shapes)
    at = dict(zip(names, skin.positions[skin_samples(skin, placed.virtual)], strict=True))
    picked = json.loads((shared_data / "rigs" / "landmarks.json").read_text())[head]
    assert placed.by_labels
    assert np.hypot(*(at["NoseHead"][:2] - picked["nose"])) <= 6.0
    assert at["Leye_Up"][1] >= picked["lidup_L"][1] - 0.5
    upward = at["ForeHead_M"] - at["Chin"]
    assert abs(np.degrees(np.arctan2(upward[0], upward[1]))) <= 3.0


def test_labels_of_one_side_show_no_plane_of_symmetry() -> None:
    labels = ("Lbrow_1", "Lbrow_2", "Lcheek_1", "Lcheek_2", "Lcheek_3", "Chin")
    places = np.random.default_rng(0).normal(0, 30, (6, 3))
    with pytest.raises(ValueError, match="labels name markers of the left side only"):
        marker_cloud(labels, places, places[None][:0]).levelled()


def test_few_markers_of_a_face_that_are_not_opposite_each_other_show_its_symmetry(demo) -> None:
    _, skin = demo
    front = skin.positions[skin.activity() > np.quantile(skin.activity(), 0.6)]
    turn = Rotation.from_euler("yz", [25, 9], degrees=True)
    errors = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        chosen = [0]
        while len(chosen) < 35:  # the farthest of some
            some = rng.choice(len(front), 100, replace=False)
            chosen.append(int(some[cdist(front[some], front[chosen]).min(axis=1).argmax()]))
        cloud = turn.apply(front[chosen])
        labels = tuple(f"m{number}" for number in range(35))
        frame, _ = marker_cloud(labels, cloud, cloud[None][:0]).levelled()
        errors.append(np.degrees(np.arccos(min(abs(frame[0] @ turn.apply([1, 0, 0])), 1.0))))
    assert max(errors) < 6


def test_sides_in_labels_tell_the_symmetry_of_markers_of_which_none_are_opposite() -> None:
    labels = ("brow_L1", "lid_L4", "cheek_L5", "jaw_L8", "brow_R2", "lid_R3", "cheek_R6", "jaw_R7")
    left = np.array([[30, 60, 40], [40, 30, 35], [55, -10, 30], [45, -60, 25]], float)
    right = np.array([[-15, 75, 45], [-20, 15, 30], [-40, -30, 40], [-30, -75, 30]], float)
    places = np.concatenate([left, right])
    frame, _ = marker_cloud(labels, places, places[None][:0]).levelled()
    assert np.degrees(np.arccos(frame[0, 0])) < 10
    unnamed = marker_cloud(tuple("abcdefgh"), places, places[None][:0])
    with pytest.raises(ValueError, match="no plane of symmetry"):
        unnamed.levelled()


@pytest.mark.parametrize("tracker", ["track", "openface"])
def test_landmarks_of_images_are_placed_at_the_rigs_own(demo, tracker: str) -> None:
    rig, skin = demo
    found = find_landmarks(skin, rig.shapes)
    names = {
        "track": {
            "eye_inner_{}": "eye_inner_{}1",
            "eye_outer_{}": "eye_outer_{}1",
            "lid_upper_{}": "lid_upper_{}4",
            "lid_lower_{}": "lid_lower_{}4",
            "mouth_{}": "mouth_corner_{}1",
            "nose_tip": "nose_tip_1",
            "mouth_middle": "lip_upper_4",
        },
        "openface": {
            "eye_inner_R": "landmark_39",
            "eye_inner_L": "landmark_42",
            "eye_outer_R": "landmark_36",
            "eye_outer_L": "landmark_45",
            "mouth_R": "landmark_48",
            "mouth_L": "landmark_54",
            "nose_tip": "landmark_30",
            "mouth_middle": "landmark_62",
        },
    }[tracker]
    pairs = {
        label.format(side): place.format(side)
        for place, label in names.items()
        for side in ("LR" if "{}" in place else "L")
    }
    labels = (*pairs, *(("iris_L1", "iris_R1") if tracker == "track" else ("landmark_33",)))
    rng = np.random.default_rng(1)
    on_rig = np.stack([found[place] for place in pairs.values()])
    more = on_rig[: len(labels) - len(pairs)] * [1, 1, 0.95]
    performer = skin.from_frame(np.concatenate([on_rig, more])) * [0.9, 0.85, 0.8] + [
        5.0,
        40.0,
        -900.0,
    ]
    performer += rng.normal(0, 0.5, performer.shape)
    misleading = performer + rng.normal(0, 1.0, (40, *performer.shape))  # noise of the detection
    cloud = marker_cloud(labels, performer, misleading)
    placed = place_markers(cloud, skin, rig.shapes)
    assert placed.by_labels
    at = skin.positions[skin_samples(skin, placed.virtual)][: len(pairs)]
    away = np.linalg.norm(at - on_rig, axis=1)
    assert away.max() < 7.0  # samples of the skin are some millimetres apart
    assert away.mean() < 3.5
