import numpy as np
import pytest

from usdface.media.picture import text
from usdface.media.picture.pixel_font import pixel_mask
from usdface.media.picture.text import TextStyle, draw_text, shortened, text_mask, text_width


@pytest.fixture
def fresh_cache():
    text.font_works.cache_clear()
    text_mask.cache_clear()
    yield
    text.font_works.cache_clear()
    text_mask.cache_clear()


def test_umlauts_are_drawn_with_their_dots() -> None:
    plain, dotted = (text_mask(word, size=40) for word in ("Groß o", "Groß ö"))
    assert plain.shape[0] == dotted.shape[0]
    # The dots lie above the o and nowhere else.
    extra = dotted.sum(axis=1) - plain.sum(axis=1)
    rows = np.flatnonzero(extra > 0.5)
    assert len(rows) > 0
    assert rows.max() < 24


def test_letters_stay_inside_their_mask_and_the_picture() -> None:
    picture = np.zeros((30, 60, 3), np.uint8)
    for x, y in ((-20, -8), (50, 20), (200, 5), (5, 5)):
        draw_text(picture, "Ägypten", x=x, y=y)
    assert picture.max() > 0
    mask = text_mask("jÄÅg", size=40)
    assert mask[0].max() == 0
    assert mask[-1].max() == 0


def test_anchors_put_the_label_left_of_in_the_middle_of_and_right_of_a_point() -> None:
    for anchor, expected in (("left", 100), ("middle", 50), ("right", 0)):
        picture = np.zeros((40, 220, 3), np.uint8)
        width = draw_text(picture, "HHHHH", x=100, y=5, anchor=anchor)
        columns = np.flatnonzero(picture.any(axis=(0, 2)))
        assert abs(columns.min() - (100 - width * (100 - expected) / 100)) <= 3


def test_long_names_are_cut_in_the_middle_to_fit() -> None:
    style = TextStyle(size=14)
    name = "a_very_long_name_of_a_take_with_version_v003"
    cut = shortened(name, style, max_width=150)
    assert text_width(cut, style) <= 150
    assert cut.startswith("a_very")
    assert cut.endswith("v003")


@pytest.mark.parametrize("weight", ["regular", "bold", "mono"])
@pytest.mark.parametrize("letter", ["…", "Ł", "Ж", "Ω", "→", "撮"])
def test_no_letter_is_left_out(weight: text.Weight, letter: str) -> None:
    """Two of the fonts know none of these, and draw nothing."""
    with_it, without = (text_mask(word, size=30, weight=weight) for word in (f"x{letter}x", "x x"))
    gap = with_it[:, 20:-22]
    assert with_it.sum() > without.sum() + 20
    assert gap.max() > 0.5
    apart = text_mask(f"a {letter} b", size=30, weight=weight)
    assert apart.shape[1] > text_mask(f"a{letter}b", size=30, weight=weight).shape[1] + 6


def test_without_a_font_labels_are_still_drawn(monkeypatch, fresh_cache) -> None:
    monkeypatch.setattr(text, "_FONTS", dict.fromkeys(text._FONTS, "NoSuchFont"))
    assert not text.font_works()
    mask = text_mask("Größe 3.5 mm", size=20)
    np.testing.assert_array_equal(mask, pixel_mask("GROSSE 3.5 MM", size=20))
    assert mask.max() == 1


def test_a_missing_font_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setattr(text, "_FONTS", dict.fromkeys(text._FONTS, "NoSuchFont"))
    with pytest.raises(text.InputError, match=r"NoSuchFont.*install the OpenImageIO wheel"):
        text.require_font()
