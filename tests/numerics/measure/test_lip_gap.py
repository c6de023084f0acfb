import numpy as np
import pytest
from scipy import sparse

from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.measure.performance_error import LipPairs, find_lip_pairs, gap_of_keys


@pytest.fixture(scope="module")
def face() -> Deformer:
    return Deformer(demo_rig())


@pytest.fixture(scope="module")
def names() -> tuple[str, ...]:
    return demo_rig().shapes


def lips_of(face: Deformer, names: tuple[str, ...], offsets=None, points=None) -> LipPairs:
    found = find_lip_pairs(
        face.neutral if points is None else points,
        face.shapes.target_offsets() if offsets is None else offsets,
        jaw_open=names.index("jawOpen"),
        mouth=shapes_by_region(names)["mouth"],
    )
    assert found is not None
    return found


def test_lips_meet_at_rest_in_the_middle_of_the_face(face, names) -> None:
    pairs = lips_of(face, names)
    low, high = face.neutral[pairs.lower], face.neutral[pairs.upper]
    assert np.abs(low[:, 0]).max() < 20.0  # not the corners
    assert np.linalg.norm(high - low, axis=1).max() < 2.0
    assert abs(pairs.rest_mm) < 1.0
    assert pairs.direction[1] > 0.5  # upwards
    assert np.linalg.norm(pairs.direction) == pytest.approx(1.0)


def test_the_corrective_that_closes_the_mouth_undoes_what_the_jaw_opens(face, names) -> None:
    gap = gap_of_keys(lips_of(face, names), face.shapes.target_offsets())
    opened, closed = gap[names.index("jawOpen")], gap[names.index("mouthClose")]
    assert opened > 20.0
    assert closed == pytest.approx(-opened, rel=0.1)
    for name in ("browInnerUp", "eyeBlinkLeft", "cheekPuff"):
        assert abs(gap[names.index(name)]) < 0.05 * opened


def test_the_gap_is_that_of_the_deformed_points(face, names) -> None:
    pairs = lips_of(face, names)
    weights = np.random.default_rng(0).uniform(0, 1, (5, len(names)))
    gap = pairs.rest_mm + face.shapes.key_weights(weights) @ gap_of_keys(
        pairs, face.shapes.key_offsets
    )
    moved = face.points(weights)
    measured = (moved[:, pairs.upper] - moved[:, pairs.lower]) @ pairs.direction
    np.testing.assert_allclose(gap, measured.mean(axis=1), atol=1e-9)


def test_a_larger_face_elsewhere_has_the_same_lips(face, names) -> None:
    pairs = lips_of(face, names)
    moved = lips_of(
        face,
        names,
        offsets=sparse.csr_array(3.0 * face.shapes.target_offsets()),
        points=3.0 * face.neutral + [100.0, -40.0, 7.0],
    )
    np.testing.assert_array_equal(pairs.lower, moved.lower)
    assert moved.rest_mm == pytest.approx(3.0 * pairs.rest_mm)


def test_a_face_without_a_mouth_has_no_lips(face, names) -> None:
    offsets = face.shapes.target_offsets()
    columns = {"mouth": shapes_by_region(names)["brows"]}  # nothing there goes with the jaw
    assert find_lip_pairs(face.neutral, offsets, jaw_open=0, mouth=np.array([], dtype=int)) is None
    assert (
        find_lip_pairs(
            face.neutral, offsets, jaw_open=names.index("jawOpen"), mouth=columns["mouth"]
        )
        is None
    )
