"""The sheet an animator works from: everything of a pair, on a screen or on paper."""

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.media.face.markers_view import draw_markers
from usdface.media.face.raycast import background
from usdface.media.picture.color import bytes_from_linear
from usdface.media.picture.reference_sheet import ReferenceRow, as_ink, compose_reference_sheet


def pair(number: int, *, video: bool = True, tuned: bool = False) -> ReferenceRow:
    rng = np.random.default_rng(number)
    face = bytes_from_linear(background(96, 96))
    face[30:70, 30:70] = (200, 150, 120)
    return ReferenceRow(
        number=number,
        place="kitchen  frame 7  01:00:00:07",
        spoken="/b/ /p/ /m/  joy",
        tuned=tuned,
        video=rng.integers(0, 255, (72, 128, 3), dtype=np.uint8) if video else None,
        missing="no video",
        markers=draw_markers(rng.normal(0, 40, (20, 3)), width=96, height=96),
        face=face,
        weights=(("jawOpen", 0.7), ("a shape with a very long name", 0.5), ("smile", 0.2)),
        residual_mm=1.25,
    )


def sheet(rows: tuple[ReferenceRow, ...], *, paper: bool = False) -> np.ndarray:
    return compose_reference_sheet(rows, title="hero", facts=("a", "b"), tile=96, paper=paper)


def test_a_sheet_has_the_shape_of_a_page() -> None:
    page = sheet(tuple(pair(i + 1) for i in range(24)))
    assert 1.0 < page.shape[1] / page.shape[0] < 2.0


def test_paper_is_white_and_a_screen_is_dark() -> None:
    rows = tuple(pair(i + 1) for i in range(4))
    paper, screen = sheet(rows, paper=True), sheet(rows)
    assert paper.shape[0] > screen.shape[0] + 100, "lines to write on"
    assert (paper[:20] == 255).all()
    assert paper.mean() > 180 > 90 > screen.mean()


def test_the_video_is_left_as_it_is_on_paper() -> None:
    filmed = pair(1)
    page = sheet((filmed,), paper=True)
    gray = np.full((72, 128, 3), 77, dtype=np.uint8)
    plain = ReferenceRow(**{**vars(filmed), "video": gray})
    shown = sheet((plain,), paper=True)
    assert (shown == 77).all(axis=2).sum() > 5000
    assert page.shape == shown.shape


def test_dots_become_ink() -> None:
    dots = draw_markers(np.zeros((1, 3)), width=64, height=64)
    inked = as_ink(dots)
    assert inked[32, 32].max() < 140
    assert inked[:8].min() > 240


def test_pairs_without_video_make_narrower_rows_or_say_so() -> None:
    filmed, blind = sheet((pair(1), pair(2))), sheet((pair(1), pair(2, video=False)))
    assert filmed.shape == blind.shape
    without = sheet((pair(1, video=False), pair(2, video=False)))
    assert without.shape != filmed.shape


def test_too_large_a_sheet_is_refused() -> None:
    with pytest.raises(InputError, match=r"too large; ask for fewer --pairs"):
        compose_reference_sheet((pair(1),) * 100, title="", facts=(), tile=2048)
