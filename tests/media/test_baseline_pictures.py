"""Faces look as they did when somebody last looked at them; a broken picture does not pass."""

import numpy as np
import pytest

from tests.media.baseline_pictures import NAMES, draw, kept, looks_like


@pytest.mark.parametrize("name", NAMES)
def test_a_face_looks_as_it_was_approved(name: str) -> None:
    assert looks_like(draw(name), kept(name)), (
        "look at it; if it is better, draw the baselines anew"
    )


def test_broken_pictures_do_not_pass() -> None:
    good = kept("neutral")
    for broken in (
        np.zeros_like(good),
        np.full_like(good, 255),
        np.roll(good, 40, axis=1),  # out of the frame
        good[:, ::-1],
        np.repeat(good.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8),
        kept("open_smile"),
    ):
        assert not looks_like(broken, good)
