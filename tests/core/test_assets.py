"""What the nouns of the package compute: the video's clock, the shapes of a rig."""

from pathlib import Path

import numpy as np
import pytest

from tests.usdio.small_rig import small_rig
from usdface.core.assets import Video
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
