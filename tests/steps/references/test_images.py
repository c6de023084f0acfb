"""Pictures of pairs, named by take and frame."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from usdface.core.progress import silent
from usdface.media.picture.image import read_picture
from usdface.steps.references import images


def test_takes_whose_names_differ_in_a_space_keep_their_own_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(shade: int, rate: object) -> Any:
        picture = np.full((16, 16, 3), shade, np.uint8)
        return nullcontext(SimpleNamespace(frame_at=lambda seconds: picture))

    monkeypatch.setattr(images, "open_video", opened)
    shades = {"shot 1": 40, "shot_1": 200}
    takes: Any = tuple(
        SimpleNamespace(
            name=name, video=SimpleNamespace(file=shade, rate=25), video_seconds=lambda frame: 0.0
        )
        for name, shade in shades.items()
    )
    spec: Any = SimpleNamespace(images=True, out=tmp_path / "hero.references.usda")
    pairs: Any = SimpleNamespace(frames=np.array([7, 7]), takes=tuple(shades))
    made: Any = SimpleNamespace(metadata={"step": "select"})
    found = images.store_images(spec, pairs, takes, made, silent)
    for file, shade in zip(found.files, shades.values(), strict=True):
        assert file is not None
        assert abs(read_picture(file).mean() - shade) < 3
