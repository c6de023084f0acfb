import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from usdface.media.picture import sheet as sheet_module
from usdface.media.picture.canvas import empty_tile, fit_picture
from usdface.media.picture.color import VERDICT_COLORS, bytes_from_linear, heat_ramp
from usdface.media.picture.error_strip import (
    _AXIS_STYLE,
    LABEL_WIDTH,
    ErrorCurve,
    ErrorStrip,
    draw_error_strip,
)
from usdface.media.picture.sheet import (
    SheetPage,
    SheetRow,
    Tile,
    compose_sheet,
    draw_legend,
)
from usdface.media.picture.sheet_layout import (
    CODE_STYLE,
    DIM_STYLE,
    GROUP_GAP,
    PAGE_MARGIN,
    READ_LETTER,
    READ_WIDTH,
    VERDICT_LINE,
    lay_out,
    legend_lines,
    verdict_lines,
    wrapped_note,
)
from usdface.media.picture.text import text_width

COLUMNS = ("video", "markers", "baseline", "solve")


def make_spec(row_count: int = 12, **changes) -> SheetPage:
    rng = np.random.default_rng(0)
    rows = tuple(
        SheetRow(
            frame=100 + 10 * n,
            timecode=f"01:00:00:{n:02d}",
            tiles=(
                Tile(np.full((90, 160, 3), 80, np.uint8), "camera A"),
                Tile(None, "no markers"),
                Tile(np.full((96, 96, 3), 120, np.uint8), value=2.0),
                Tile(np.full((96, 96, 3), 120 + n, np.uint8), value=0.5),
            ),
            note="größter Fehler",
        )
        for n in range(row_count)
    )
    spec = SheetPage(
        title="Küche_v003",
        columns=COLUMNS,
        rows=rows,
        facts=("take 3", "performer Jürgen"),
        curves=(
            ErrorCurve("baseline", rng.uniform(1, 3, 500)),
            ErrorCurve("solve", rng.random(500)),
        ),
        first_frame=1,
        notes=("hollow: not seen",),
        high=3.0,
        tile_height=96,
    )
    return dataclasses.replace(spec, **changes)


def test_a_long_head_of_a_column_leaves_the_others_as_they_are() -> None:
    short, long = (
        compose_sheet(make_spec(columns=(name, *COLUMNS[1:]))) for name in ("a", "camera " * 30)
    )
    differing = np.flatnonzero((short != long).any(axis=(0, 2)))
    layout = lay_out(make_spec())
    blocks = (differing - PAGE_MARGIN) // (layout.group_width + GROUP_GAP)
    within = differing - PAGE_MARGIN - blocks * (layout.group_width + GROUP_GAP)
    assert within.max() <= layout.column_widths[0] + 2


def test_every_tile_is_on_the_sheet_unchanged() -> None:
    sheet = compose_sheet(make_spec())
    for n in range(12):
        inside = np.all(sheet == 120 + n, axis=2).sum()
        assert inside >= 94 * 94  # all but the frame about it


@pytest.mark.parametrize("row_count", [1, 2, 5, 12, 25, 60])
def test_sheet_is_neither_a_tower_nor_a_ribbon(row_count: int) -> None:
    height, width, _ = compose_sheet(make_spec(row_count)).shape
    assert 0.6 < width / height < 3.2


@pytest.mark.parametrize("tile_height", [64, 160, 320])
def test_nothing_is_drawn_over_the_page_margin(tile_height: int) -> None:
    sheet = compose_sheet(make_spec(3, tile_height=tile_height, title="long title " * 40))
    page = sheet[0, 0]
    for edge in (sheet[:20], sheet[-20:], sheet[:, :20], sheet[:, -20:]):
        assert np.all(edge == page)


@pytest.mark.parametrize("tile_height", [64, 96, 320])
def test_an_error_is_never_cut_to_other_digits(tile_height: int, monkeypatch) -> None:
    """0.53 mm below a small tile was drawn as 0."""
    drawn: list[tuple[str, int | None]] = []
    draw = sheet_module.draw_text

    def keep(page, text, *, max_width=None, **more):
        drawn.append((text, max_width))
        return draw(page, text, max_width=max_width, **more)

    monkeypatch.setattr(sheet_module, "draw_text", keep)
    tile = Tile(np.full((96, 60, 3), 120, np.uint8), value=12.53)
    compose_sheet(make_spec(columns=("solve",), rows=(SheetRow(1, "", (tile,)),), tile_height=64))
    compose_sheet(make_spec(tile_height=tile_height))
    wanted = ("12.53", "2.00", "0.50")
    values = [(text, width) for text, width in drawn if text.startswith(wanted)]
    assert len(values) == 1 + 24
    assert all(width is None for _, width in values)


@pytest.mark.parametrize("side", [64, 96, 160, 320])
def test_a_caption_below_a_small_tile_is_never_cut_to_other_digits(side: int, monkeypatch) -> None:
    """max 1.3 mm below a small tile was drawn as max…3 mm."""
    drawn: list[tuple[str, int, int]] = []

    def keep(page, text, *, style, max_width=9999, **more):
        drawn.append((text, text_width(text, style), max_width))
        return 0

    monkeypatch.setattr(sheet_module, "draw_text", keep)
    tile = Tile(np.full((96, 96, 3), 120, np.uint8), "max 12.3 mm")
    compose_sheet(make_spec(columns=("error",), rows=(SheetRow(1, "", (tile,)),), tile_height=side))
    captions = [each for each in drawn if each[0].startswith("max 12.3")]
    assert len(captions) == 1
    assert captions[0][1] <= captions[0][2]


@pytest.mark.parametrize("width", [800, 1000, 1600, 4000])
def test_notes_are_told_whole_whatever_the_width(width: int, monkeypatch) -> None:
    notes = ("error: RMS distance of the markers from what the weights explain; not the keys",) * 3
    lines = legend_lines(notes, width)
    assert " ".join(lines).replace("   ·   ", " ") == " ".join(notes)
    cut: list[str] = []
    monkeypatch.setattr(
        "usdface.media.picture.text._cut", lambda text, kept: cut.append(text) or ""
    )
    page = np.zeros((400, width, 3), np.uint8)
    draw_legend(page, lines, x=36, y=10, width=width - 72, high="1.5 mm")
    assert not cut


@pytest.mark.parametrize(("columns", "tile"), [(2, 320), (5, 320), (5, 640)])
def test_the_smallest_letters_are_twelve_pixels_on_a_screen(columns: int, tile: int) -> None:
    picture = np.zeros((tile, tile, 3), np.uint8)
    rows = tuple(SheetRow(n, "", (Tile(picture),) * columns) for n in range(12))
    page = SheetPage("sheet", ("a",) * columns, rows, tile_height=tile)
    layout = lay_out(page)
    shown = min(READ_WIDTH / layout.width, 1.0)
    smallest = min(CODE_STYLE.size, _AXIS_STYLE.size)
    assert smallest * layout.scale * shown >= READ_LETTER - 1e-9
    sheet = compose_sheet(page)
    assert sheet.shape[:2] == (layout.height, layout.width)


@pytest.mark.parametrize("level", ["good", "check", "bad"])
def test_a_verdict_is_written_whole_in_its_colour_which_runs_down_the_page(level: str) -> None:
    rows = (SheetRow(7, "", tuple(Tile(None) for _ in COLUMNS)),)
    plain = SheetPage("bare", COLUMNS, rows, tile_height=64)
    sentence = "a sentence that is longer than a sheet is wide " * 4
    sheet = compose_sheet(replace(plain, verdict=(level, sentence, "To do: tune")))
    assert (sheet[:, 2] == VERDICT_COLORS[level]).all()
    lines = verdict_lines((level, sentence, "To do: tune"), sheet.shape[1], 1.0)
    assert " ".join(lines[:-1]) == sentence.strip()
    assert len(sheet) == len(compose_sheet(plain)) + len(lines) * VERDICT_LINE


def test_a_note_too_long_for_its_row_stands_whole_on_lines_of_its_own() -> None:
    note = "mouth: uncertainty 1.23 mm, coverage 22%, lips 2.1 mm open"
    rows = tuple(SheetRow(n, "01:00:00:00", (Tile(None),), note=note) for n in (7, 8))
    page = SheetPage("bare", ("a",), rows, tile_height=200)
    layout = lay_out(page)
    lines = wrapped_note(rows[0], 1, layout)
    assert " ".join(lines) == note
    assert all(text_width(line, DIM_STYLE.scaled(layout.scale)) <= 200 for line in lines)
    assert layout.head_lines == 1 + len(lines) > 2
    wide = replace(page, tile_height=1600)
    assert (wrapped_note(rows[0], 1, lay_out(wide)), lay_out(wide).head_lines) == ([], 1)
    assert compose_sheet(page).shape[:2] == (layout.height, layout.width)


def test_without_keys_no_value_is_the_best() -> None:
    rows = (SheetRow(7, "", (Tile(None, value=0.1), Tile(None, value=2.0))),)
    page = SheetPage("bare", ("a", "b"), rows, tile_height=64, high=3.0)
    assert (compose_sheet(page) != compose_sheet(replace(page, comparable=False))).any()


def test_sheet_without_curves_values_and_facts_is_still_made() -> None:
    rows = (SheetRow(7, "", tuple(Tile(None) for _ in COLUMNS)),)
    sheet = compose_sheet(SheetPage("bare", COLUMNS, rows, tile_height=64))
    assert sheet.dtype == np.uint8


def test_strip_keeps_the_peak_of_a_single_frame() -> None:
    values = np.zeros(100_000)
    values[61_803] = 2.0
    page = np.zeros((120, LABEL_WIDTH + 600, 3), np.uint8)
    strip = ErrorStrip((ErrorCurve("", values),), first_frame=0, high=2.0)
    draw_error_strip(page, strip, x=0, y=0, width=LABEL_WIDTH + 584)
    hot = bytes_from_linear(heat_ramp(np.array([2.0]), high=2.0))[0]
    columns = np.flatnonzero(np.all(page == hot, axis=2).any(axis=0))
    assert len(columns) == 1
    assert columns[0] == pytest.approx(LABEL_WIDTH + 0.61803 * 584, abs=1)


def test_strip_marks_the_frames_of_the_rows() -> None:
    page = np.zeros((120, LABEL_WIDTH + 600, 3), np.uint8)
    marked = page.copy()
    curve = ErrorCurve("", np.ones(600))
    for picture, marks in ((page, ()), (marked, ((1300, "1"),))):
        strip = ErrorStrip((curve,), first_frame=1000, high=2.0, marks=marks)
        draw_error_strip(picture, strip, x=0, y=0, width=LABEL_WIDTH + 584)
    columns = np.flatnonzero(np.any(page != marked, axis=(0, 2)))
    assert abs(columns.mean() - (LABEL_WIDTH + 292)) < 4


def test_unknown_errors_leave_a_gap() -> None:
    values = np.ones(600)
    values[200:400] = np.nan
    page = np.zeros((120, LABEL_WIDTH + 600, 3), np.uint8)
    strip = ErrorStrip((ErrorCurve("", values),), first_frame=0, high=1.0)
    draw_error_strip(page, strip, x=0, y=0, width=LABEL_WIDTH + 584)
    lane = page[60, LABEL_WIDTH:]
    assert np.all(lane[210:380] == lane[300])
    assert np.any(lane[100] != lane[300])


def test_fitted_picture_keeps_its_shape_and_its_mean() -> None:
    rng = np.random.default_rng(0)
    smooth = np.clip(rng.normal(120, 30, (9, 16, 3)), 0, 255).astype(np.uint8)
    picture = np.kron(smooth, np.ones((40, 40, 1), np.uint8))
    fitted = fit_picture(picture, width=160, height=160, color=(0, 0, 0))
    assert np.all(fitted[:34] == 0)
    assert np.all(fitted[-34:] == 0)
    inside = fitted[35:125]
    np.testing.assert_allclose(inside.mean(axis=(0, 1)), picture.mean(axis=(0, 1)), atol=1.0)


def test_picture_of_the_right_size_is_not_touched() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (50, 70, 3), dtype=np.uint8)
    np.testing.assert_array_equal(fit_picture(picture, width=70, height=50), picture)


def test_empty_tile_says_why() -> None:
    assert np.any(empty_tile(200, 100, "video ends") != empty_tile(200, 100, ""))


def test_there_is_no_ramp_where_nothing_has_a_colour_on_it() -> None:
    pages = []
    for high in ("", "3 mm"):
        page = np.zeros((60, 800, 3), np.uint8)
        draw_legend(page, ("a note",), x=36, y=10, width=700, high=high)
        pages.append(page.max(axis=2).astype(int) - page.min(axis=2))  # of colours, not greys
    assert pages[0].max() < 40 < pages[1].max()
