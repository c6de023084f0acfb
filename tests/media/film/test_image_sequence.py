"""Numbered pictures read as a movie."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by
import pytest

from usdface.core.errors import InputError
from usdface.media.film.timed_frames import ImageSequence
from usdface.media.film.video import open_video
from usdface.media.picture.image import write_image


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    for number in (998, 999, 1000, 1002):  # 1001 is missing; the width of the number grows
        write_image(tmp_path / f"plate.{number}.png", np.full((8, 8, 3), number % 256, np.uint8))
    write_image(tmp_path / "other.1001.png", np.zeros((8, 8, 3), np.uint8))
    return tmp_path / "plate.999.png"


def test_pictures_appear_at_their_time_and_a_missing_one_holds_the_last(sequence: Path) -> None:
    with open_video(sequence, Fraction(25)) as video:
        shown = [video.frame_at(i / 25)[0, 0, 0] for i in range(5)]
        assert shown == [998 % 256, 999 % 256, 1000 % 256, 1000 % 256, 1002 % 256]
        assert video.frame_at(5 / 25) is None
        assert video.frame_at(-0.01) is None
        assert video.duration == pytest.approx(0.2)


@pytest.mark.parametrize("named", ["7", "007"])
def test_of_two_pictures_with_one_number_that_of_the_given_digits_is_shown(
    tmp_path: Path, named: str
) -> None:
    for digits in ("007", "7", "08"):
        write_image(tmp_path / f"a.{digits}.png", np.full((8, 8, 3), len(digits), np.uint8))
    with open_video(tmp_path / f"a.{named}.png", Fraction(24)) as video:
        assert [video.frame(index)[0, 0, 0] for index in (0, 1)] == [len(named), 2]


def test_linear_exr_and_one_channel_become_srgb(tmp_path: Path) -> None:
    grey = np.full((8, 8, 3), 100, np.uint8)
    write_image(tmp_path / "a.1.exr", grey)
    picture = ImageSequence(tmp_path / "a.1.exr", Fraction(24)).frame_at(0.0)
    np.testing.assert_allclose(picture, grey, atol=1)


@pytest.mark.parametrize(("data", "place"), [((20, 10), (6, 5)), ((48, 36), (-8, -6))])
def test_exr_is_shown_by_its_display_window(
    tmp_path: Path, data: tuple[int, int], place: tuple[int, int]
) -> None:
    """Programs crop the data to what is not black, or render more than the picture."""
    path, (width, height), (left, top) = tmp_path / "a.1.exr", data, place
    spec = oiio.ImageSpec(width, height, 3, "half")
    spec.x, spec.y, spec.full_width, spec.full_height = left, top, 32, 24
    pixels = np.zeros((height, width, 3), np.float32)
    pixels[8 - top : 12 - top, 10 - left : 20 - left] = 1.0
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    whole = np.zeros((24, 32, 3), np.uint8)
    whole[8:12, 10:20] = 255
    np.testing.assert_array_equal(ImageSequence(path, Fraction(24)).frame(0), whole)


def test_a_sequence_needs_a_rate_a_number_and_pictures(tmp_path: Path, sequence: Path) -> None:
    with pytest.raises(InputError, match="give it with --video-rate"):
        open_video(sequence)
    with pytest.raises(InputError, match="needs a number in its name"):
        open_video(tmp_path / "plate.png", Fraction(24))
    (tmp_path / "bad.1.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"bad\.1\.png"):
        open_video(tmp_path / "bad.1.png", Fraction(24)).frame_at(0.0)
