import numpy as np
import pytest
from scipy import sparse

from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.numerics.measure.face_regions import (
    blinks,
    jaw_opener,
    points_by_region,
    region_gram,
    region_of_shape,
)


@pytest.fixture(scope="module")
def face() -> Deformer:
    return Deformer(demo_rig())


@pytest.fixture(scope="module")
def names() -> tuple[str, ...]:
    return demo_rig().shapes


@pytest.mark.parametrize(
    ("name", "region"),
    [
        ("browDownLeft", "brows"),
        ("brow_raise_R", "brows"),
        ("eyeBlink_L", "lids"),
        ("eyeWideRight", "lids"),
        ("Upper_Lid_Close", "lids"),
        ("cheekSquintLeft", "cheeks and nose"),
        ("noseSneer_R", "cheeks and nose"),
        ("mouthPucker", "mouth"),
        ("lipCornerPuller", "mouth"),
        ("jawOpen", "jaw"),
        ("jawSlide_L", "jaw"),
        ("mouthSlideR", "mouth"),
        ("eyeLookInLeft", ""),
        ("tongueOut", ""),
        ("AU12", ""),
    ],
)
def test_a_shape_belongs_where_its_name_says(name: str, region: str) -> None:
    assert region_of_shape(name) == region


def test_points_belong_to_what_moves_them(face, names) -> None:
    offsets = face.shapes.target_offsets()
    points = points_by_region(offsets, names)
    assert set(points) == {"brows", "lids", "cheeks and nose", "mouth", "jaw"}
    together = np.concatenate(list(points.values()))
    assert len(together) == len(set(together.tolist())) < len(face.neutral)
    height = {name: np.median(face.neutral[held, 1]) for name, held in points.items()}
    assert height["brows"] > height["lids"] > height["cheeks and nose"] > height["mouth"]
    assert height["mouth"] > height["jaw"]
    pucker = offsets[[names.index("mouthPucker")]].toarray().reshape(-1, 3)
    lips = np.argsort(-np.linalg.norm(pucker, axis=1))[:100]
    assert np.isin(lips, points["mouth"]).all()  # the lower lip too, though the jaw carries it


def test_the_tongue_that_the_jaw_carries_is_none_of_its_points() -> None:
    jaw, tongue = np.zeros((2, 10, 3))
    jaw[:6] = [0.0, -12.0, 2.0]
    tongue[4:6] = [0.0, 0.0, 30.0]
    offsets = sparse.csr_array(np.stack([jaw, tongue]).reshape(2, -1))
    points = points_by_region(offsets, ("jawOpen", "tongueOut"))
    assert points["jaw"].tolist() == [0, 1, 2, 3]


def test_a_regions_gram_is_its_points_motion(face, names) -> None:
    offsets = face.shapes.target_offsets()
    points = np.array([5, 800, 4000])
    error = np.random.default_rng(0).normal(size=len(names))
    moved = np.asarray(error @ offsets).reshape(-1, 3)[points]
    squared = error @ region_gram(offsets, points) @ error
    assert squared == pytest.approx((moved**2).sum(axis=1).mean(), rel=1e-12)


def test_blinks_and_the_jaw_are_found_by_name(names) -> None:
    assert [names[i] for i in blinks(names)] == ["eyeBlinkLeft", "eyeBlinkRight"]
    assert jaw_opener(names) == names.index("jawOpen")
    assert jaw_opener(("smile", "Jaw_Drop")) == 1
    assert jaw_opener(("mouthOpen", "jawLeft")) is None
