"""What the nouns of the package compute: the video's clock, the shapes of a rig."""

from pathlib import Path

import numpy as np
import pytest

from tests.usdio.small_rig import small_rig
from usdface.core.assets import References, Video
from usdface.core.errors import InputError


def test_times_of_the_video_and_of_the_take_are_each_others_inverse() -> None:
    video = Video(Path("a.mov"), offset=1.5, drift=200.0)
    assert video.take_time(0.0) == 1.5
    assert video.take_time(1000.0) == pytest.approx(1001.7)
    seconds = np.linspace(-5.0, 5000.0, 7)
    np.testing.assert_allclose(video.take_time(video.video_time(seconds)), seconds, atol=1e-9)


def test_shapes_that_a_rig_lacks_are_named_with_the_file_that_has_them() -> None:
    rig = small_rig()
    rig.check_has(rig.shapes, source="a.usda", remedy="train again")
    with pytest.raises(
        InputError, match=r"^a\.usda: 1 of its 2 shapes are not on .*\(grin\); train again$"
    ):
        rig.check_has([rig.shapes[0], "grin"], source="a.usda", remedy="train again")


def test_a_part_of_the_references_keeps_what_is_known_of_each_pair() -> None:
    pairs = References(
        marker_names=("m",),
        shape_names=("a", "b"),
        markers=np.arange(12.0).reshape(4, 1, 3),
        weights=np.arange(8.0).reshape(4, 2),
        frames=np.arange(4),
        takes=("w", "x", "y", "z"),
        tuned=np.array([True, False, True, False]),
        rigid=(),
        neutral=np.zeros((1, 3)),
        rig_file=Path("rig.usda"),
        rig_prim="/rig",
        visemes=("p", "q", "r", "s"),
        authors=("Kim", "", "Lee", ""),
        source=np.arange(4.0)[:, None],
    )
    for kept in (pairs.tuned, np.array([0, 2])):
        some = pairs.rows(kept)
        assert (some.takes, some.visemes, some.authors) == (("w", "y"), ("p", "r"), ("Kim", "Lee"))
        assert some.emotions == ()
        assert some.tuned.all()
        assert some.source is not None
        for each in (
            some.frames,
            some.source[:, 0],
            some.weights[:, 0] / 2,
            some.markers[:, 0, 0] / 3,
        ):
            np.testing.assert_array_equal(each, [0, 2])
