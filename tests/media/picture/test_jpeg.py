"""Pictures for pages decode to what they were."""

import io

import av
import numpy as np

from usdface.media.picture.jpeg import encode_jpeg


def decode(data: bytes) -> np.ndarray:
    with av.open(io.BytesIO(data)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def gradient(height: int, width: int) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width]
    red, green = 255 * rows / height, 255 * columns / width
    return np.stack([red, green, np.full_like(red, 90)], axis=-1).astype(np.uint8)


def test_a_picture_comes_back_in_its_colours() -> None:
    picture = gradient(101, 77)
    back = decode(encode_jpeg(picture))
    assert back.shape == picture.shape
    assert np.abs(back.astype(int) - picture).mean() < 2.5


def test_a_tall_picture_is_made_smaller_and_keeps_its_proportions() -> None:
    assert decode(encode_jpeg(gradient(600, 300), max_height=200)).shape == (200, 100, 3)
