"""Landmarks' names, which face is followed, how far samples are trusted, models that are none."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.capture.simulated_faces import SCORES, SimulatedFinder, turning_head
from usdface.capture.face_landmarker import FaceLandmarker, check_model, named_model
from usdface.capture.face_landmarks import LANDMARK_COUNT, LANDMARKS
from usdface.capture.face_tracking import LASTING_PICTURES, FaceTracker, detect_faces
from usdface.core.errors import InputError
from usdface.model.placement.label_hints import label_hint, mirrored_label

PICTURE = np.zeros((480, 640, 3), np.uint8)


def follow(finder: SimulatedFinder, count: int, choice=None, *, mirrored: bool = False):
    tracker = FaceTracker(choice, mirrored=mirrored)
    pictures = [detect_faces(finder, PICTURE, mirrored=mirrored) for _ in range(count)]
    tracker.choose(pictures[:LASTING_PICTURES])
    for number, found in enumerate(pictures):
        tracker.add(found, where=f"clip.mp4 picture {number}")
    return tracker.track(SCORES, (640, 480))


def test_names_say_part_and_side_and_mirror_each_other() -> None:
    assert len(set(LANDMARKS.names)) == len(set(LANDMARKS.indices.tolist())) == 205
    assert LANDMARKS.indices.max() == LANDMARK_COUNT - 1
    for column, name in enumerate(LANDMARKS.names):
        hint = label_hint(name)
        assert hint.region or name.startswith("iris"), name
        partner = LANDMARKS.names[LANDMARKS.mirror[column]]
        assert partner in mirrored_label(name) if hint.side else partner == name


def test_several_faces_are_refused_or_one_is_followed() -> None:
    def two(number: int):
        near, far = turning_head(number, at=(90, 0, -600)), turning_head(number, at=(-150, 0, -800))
        if number == 3:  # one is lost for a moment; the other is not taken for it
            return [np.add(far, [1, 0, 0]), near]
        return [near, far] if number % 2 else [far, near]

    with pytest.raises(InputError, match=r"picture 0: 2 faces .* --face largest, left or right"):
        follow(SimulatedFinder(two, focal_pixels=600), 1)
    middle = {}
    for choice in ("largest", "left", "right"):
        track = follow(SimulatedFinder(two, focal_pixels=600), 6, choice)
        middle[choice] = track.positions[..., 0].mean(axis=1)
        assert np.ptp(middle[choice]) < 20  # it never jumps to the other
    assert middle["left"].mean() < 320 < middle["right"].mean()
    np.testing.assert_array_equal(middle["largest"], middle["right"])


def test_scores_are_the_mean_of_the_picture_and_its_mirror_image() -> None:
    class Lopsided(SimulatedFinder):
        """Scores a blink too high on the left of what it sees."""

        def find_faces(self, picture):
            faces = super().find_faces(picture)
            for face in faces:
                face.scores[SCORES.index("eyeBlinkLeft")] += 0.2
            return faces

    finder = Lopsided(lambda number: [turning_head(number)], focal_pixels=600, looks=2)
    scores = follow(finder, 3, mirrored=True).scores
    left, right = (scores[:, SCORES.index(f"eyeBlink{side}")] for side in ("Left", "Right"))
    np.testing.assert_allclose(left, 0.1 + 0.1, atol=1e-6)
    np.testing.assert_allclose(right, 0.3 + 0.1, atol=1e-6)
    np.testing.assert_allclose(scores[:, 2], [0.5, 0.51, 0.52], atol=1e-6)


@pytest.mark.parametrize("choice", ["left", "right"])
def test_the_other_face_is_never_measured_while_one_is_lost(choice: str) -> None:
    def two(number: int):
        near, far = turning_head(number, at=(90, 0, -600)), turning_head(number, at=(-150, 0, -800))
        lost = choice if 3 <= number < 6 else ""
        return [face for side, face in (("left", far), ("right", near)) if side != lost]

    track = follow(SimulatedFinder(two, focal_pixels=600), 9, choice)
    np.testing.assert_array_equal(np.flatnonzero(~track.seen), [3, 4, 5])
    assert np.ptp(track.positions[track.seen, :, 0].mean(axis=1)) < 20


@pytest.mark.parametrize("choice", ["left", "right"])
def test_the_wanted_face_may_be_missed_or_a_false_one_found_at_the_start(choice: str) -> None:
    """Models find some faces only from the third picture on."""
    near, far, false = (
        turning_head(0, at=at) for at in ((90, 0, -600), (-150, 0, -800), (0, 0, -700))
    )

    def two(number: int):
        if number < 2:
            return [near if choice == "left" else far]
        return [near, far, np.add(false, [300 if choice == "right" else -300, 0, 0])][
            : 3 if number == 4 else 2
        ]

    track = follow(SimulatedFinder(two, focal_pixels=600), 15, choice)
    np.testing.assert_array_equal(np.flatnonzero(~track.seen), [0, 1])
    middle = track.positions[2:, :, 0].mean(axis=1)
    assert np.ptp(middle) < 20
    assert 0 < middle.mean() < 320 if choice == "left" else 320 < middle.mean() < 500


def test_one_face_that_is_found_twice_is_one() -> None:
    finder = SimulatedFinder(lambda n: [turning_head(n), turning_head(n) + 2.0], focal_pixels=600)
    assert follow(finder, 2).seen.all()


def test_a_small_face_in_the_background_is_nobody() -> None:
    def crowd(number: int):
        return [turning_head(number, at=(-400, 200, -1500)), turning_head(number)]

    track = follow(SimulatedFinder(crowd, focal_pixels=600), 3)
    assert np.abs(track.positions[..., 0].mean(axis=1) - 320).max() < 20


def test_a_second_face_is_refused_only_if_it_lasts() -> None:
    def passing(pictures: int):
        other = turning_head(0, at=(-150, 0, -700))
        return lambda n: [turning_head(n), other] if 5 <= n < 5 + pictures else [turning_head(n)]

    track = follow(SimulatedFinder(passing(11), focal_pixels=600), 20)
    assert np.abs(track.positions[..., 0].mean(axis=1) - 320).max() < 20
    with pytest.raises(InputError, match="picture 16: 2 faces"):
        follow(SimulatedFinder(passing(12), focal_pixels=600), 20)


def test_the_mirror_image_takes_out_what_leans_to_one_side() -> None:
    """A model that puts all points too far to the right does so in the mirror as well."""
    plain = follow(SimulatedFinder(lambda n: [turning_head(n)], focal_pixels=600), 5)
    leaning = SimulatedFinder(lambda n: [turning_head(n)], focal_pixels=600, looks=2, bias=3.0)
    track = follow(leaning, 5, mirrored=True)
    np.testing.assert_allclose(track.difference, 6.0, atol=0.01)
    np.testing.assert_allclose(track.positions, plain.positions, atol=0.01)


def test_samples_that_differ_in_the_mirror_are_not_trusted() -> None:
    rng = np.random.default_rng(0)
    lips = LANDMARKS.columns("lip_upper", "lip_lower")

    def covered(number: int):
        points = turning_head(number) + rng.normal(size=(LANDMARK_COUNT, 3)) * (0.2, 0.2, 0)
        if 20 <= number < 24:  # a hand before the mouth
            points[LANDMARKS.indices[lips]] += rng.normal(size=(len(lips), 3)) * (6, 6, 0)
        return [points] if number != 30 else []

    track = follow(SimulatedFinder(covered, focal_pixels=600, looks=2), 40, mirrored=True)
    trust = track.confidence()
    assert (trust[30] == 0).all()
    usual = np.delete(np.arange(40), [20, 21, 22, 23, 30])
    assert (trust[usual] == 1).mean() > 0.98
    others = np.setdiff1d(np.arange(len(LANDMARKS.names)), lips)
    assert np.median(trust[20:24][:, lips]) < 0.5
    assert np.median(trust[20:24][:, others]) == 1


def bundle(path: Path, *members: str) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for member in members:
            file.writestr(member, b"x" * 2000)
    return path


def test_a_model_that_is_none_is_refused_with_what_it_must_be(tmp_path: Path) -> None:
    parts = ("face_detector.tflite", "face_landmarks_detector.tflite", "face_blendshapes.tflite")
    whole = bundle(tmp_path / "whole.task", *parts)
    assert len(check_model(whole)) == 64
    cut = tmp_path / "cut.task"
    cut.write_bytes(whole.read_bytes()[:3000])
    damaged = tmp_path / "damaged.task"
    damaged.write_bytes(whole.read_bytes().replace(b"x" * 2000, b"x" * 1999 + b"y", 1))
    other = bundle(tmp_path / "hand.task", "hand_detector.tflite")
    for path, message in (
        (tmp_path / "none.task", r"none\.task: no such file; .* --model"),
        (cut, r"cut\.task: is not a model bundle, or is truncated \(3000 bytes"),
        (damaged, r"face_detector\.tflite in it is damaged"),
        (other, r"another task: it holds hand_detector\.tflite, and no face_detector"),
    ):
        with pytest.raises(InputError, match=message):
            check_model(path)


def test_the_model_is_named_by_the_user_or_his_environment(monkeypatch) -> None:
    monkeypatch.setenv("USDFACE_FACE_MODEL", "models/face.task")
    assert named_model(None) == Path("models/face.task")
    assert named_model(Path("own.task")) == Path("own.task")
    monkeypatch.delenv("USDFACE_FACE_MODEL")
    wanted = r"no model is named: .*face_landmarker\.task \(3\.8 MB, Apache 2\.0.*_FACE_MODEL"
    with pytest.raises(InputError, match=wanted):
        named_model(None)


def test_without_the_extra_its_name_and_size_are_said(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(InputError, match=r"usdface\[track\] \(340 MB on disk, Apache 2\.0\)"):
        FaceLandmarker(tmp_path / "any.task")
