"""A picture that says it is enormous is refused before it is unpacked."""

from pathlib import Path

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.media.picture import image as picture
from usdface.media.picture.image import write_image


def test_a_picture_too_large_for_the_page_is_refused(tmp_path: Path, monkeypatch) -> None:
    write_image(tmp_path / "a.png", np.zeros((8, 8, 3), np.uint8))
    monkeypatch.setattr(picture, "MAX_VALUES", 8 * 8 * 3 - 1)
    with pytest.raises(InputError, match=r"a\.png: 8 × 8 with 3 channels is too large"):
        picture.read_picture(tmp_path / "a.png")
