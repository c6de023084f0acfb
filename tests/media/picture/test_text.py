import numpy as np
import pytest

from usdface.media.picture import text
from usdface.media.picture.text import TextStyle, draw_text, shortened, text_mask, text_width


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
    with_it, without = (text_mask(word, size=30, weight=weight) for word in (f"x{letter}x", "x x"))
    gap = with_it[:, 20:-22]
    assert with_it.sum() > without.sum() + 20
    assert gap.max() > 0.5
    spaced = text_mask(f"a {letter} b", size=30, weight=weight)
    assert spaced.shape[1] > text_mask(f"a{letter}b", size=30, weight=weight).shape[1] + 6


@pytest.mark.parametrize("letter", ["Ł", "ż", "Ж", "й", "Ω", "ώ", "→", "…", "²"])
def test_letters_of_europe_are_no_boxes(letter: str) -> None:
    for weight in ("regular", "bold", "mono"):
        assert not text._is_missing(letter, text.font_file(weight))


def test_what_the_fonts_lack_is_drawn_by_a_font_of_this_machine(monkeypatch) -> None:
    """STIX stands for a Japanese font: it has letters that DejaVu Sans Mono lacks."""
    letter = "\N{MATHEMATICAL FRAKTUR CAPITAL A}"
    mono = text.font_file("mono")
    assert text._is_missing(letter, mono)
    box = text_mask(letter, size=30, weight="mono").copy()
    text_mask.cache_clear()
    other = mono.with_name("STIXGeneral.ttf")
    monkeypatch.setattr(text, "east_asian_font_file", lambda: other)
    assert not np.array_equal(text_mask(letter, size=30, weight="mono"), box)
    text_mask.cache_clear()


def test_a_missing_font_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setattr(text, "_FONT_FILES", dict.fromkeys(text._FONT_FILES, "NoSuchFont.ttf"))
    with pytest.raises(text.InputError, match=r"NoSuchFont.*install the matplotlib wheel"):
        text.font_file.__wrapped__("bold")  # not the one it remembers
