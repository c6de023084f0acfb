"""What people do on a report, in a real browser: one page, opened anew for each test."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.steps.review.test_report import FRAME, open_page, spec_of, visit, wait_for
from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec
from usdface.specs.notes import read_notes
from usdface.specs.references import ReferencesAddSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_references

NOTE = {"id": "a1", "frame": 120, "last": 130, "text": "jaw too open", "made": "2026-01-01"}


@pytest.fixture(scope="module")
def reported(finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """A shot with a report, a version before an edit, and notes; tests do not change it."""
    folder = tmp_path_factory.mktemp("report") / "shot"
    shutil.copytree(finished_shot.folder, folder)
    shot = Shot(folder, finished_shot.rigid, finished_shot.neutral)
    for name in ("shot.hero.usda", "shot.hero.weights.usdc"):
        shutil.copy(shot / name, shot / name.replace("hero", "first"))
    layer = (shot / "shot.first.usda").read_text(encoding="utf-8")
    (shot / "shot.first.usda").write_text(layer.replace("shot.hero.w", "shot.first.w"))
    execute(
        EditSpec(performance=shot / "shot.hero.usda", shape=("jawOpen",), add=0.3, frames="90-110")
    )
    write_notes(shot / "shot.hero.notes.json", [NOTE | {"version": "of another"}])
    execute(spec_of(shot, against=shot / "keys.csv", also=(shot / "shot.first.usda",), worst=2))
    return shot


@pytest.fixture(scope="module")
def opened(browser: Any, reported: Shot) -> Iterator[tuple[Any, list[str]]]:
    faults: list[str] = []
    page = open_page(browser, reported / "shot.html", faults)
    yield page, faults
    page.close()


@pytest.fixture
def player(opened: tuple[Any, list[str]]) -> Iterator[Any]:
    """The page of several tests, at its first frame; they leave all else as they find it."""
    page, faults = opened
    page.evaluate("report.show(0)")
    yield page
    assert not faults


@pytest.fixture
def page(browser: Any, reported: Shot) -> Iterator[Any]:
    """A page that the test may change."""
    faults: list[str] = []
    own = open_page(browser, reported / "shot.html", faults)
    yield own
    own.close()
    assert not faults


def write_notes(path: Path, notes: list[dict[str, Any]], **other: object) -> Path:
    path.write_text(json.dumps({"usdface_notes": 1, "notes": notes} | other), encoding="utf-8")
    return path


def at(page: Any) -> int:
    return int(page.evaluate(FRAME))


def test_a_range_is_marked_and_looped(player: Any) -> None:
    player.evaluate("report.show(99)")
    player.keyboard.press("[")
    player.evaluate("report.show(104)")
    player.keyboard.press("]")
    assert player.inner_text("#range") == "100–105"
    seen = player.evaluate(
        """async () => {
          const seen = new Set();
          report.play(true, { speed: 1 });
          for (let i = 0; i < 500 && seen.size < 3; i++) {
            await new Promise((next) => setTimeout(next, 10));
            seen.add(report.picture);
          }
          report.play(false);
          return [...seen];
        }"""
    )
    assert set(seen) <= set(range(99, 105))
    assert len(seen) == 3
    player.keyboard.press("Escape")
    assert player.inner_text("#range") == ""


def test_errors_against_keys_of_few_frames_are_seen(
    browser: Any, reported: Shot, tmp_path: Path
) -> None:
    """No two of these keys are neighbours, so that no line connects them."""
    names, *rows = (reported / "keys.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "few.csv").write_text("\n".join([names, *rows[::10]]), encoding="utf-8")
    execute(spec_of(reported, against=tmp_path / "few.csv", out=tmp_path / "few.html", worst=1))
    faults: list[str] = []
    page = open_page(browser, tmp_path / "few.html", faults)
    path = page.locator("#strips path.strip-error")
    assert path.get_attribute("class") == "strip-error dots"
    style = "e => [getComputedStyle(e).strokeLinecap, parseFloat(getComputedStyle(e).strokeWidth)]"
    assert path.evaluate(style) == ["round", 4]
    page.evaluate("report.show(5)")
    page.locator("#live", has_text="error unknown, ").wait_for()
    page.close()
    assert not faults


def test_the_shuttle_plays_back_rests_and_plays_faster(player: Any) -> None:
    player.evaluate("report.show(300)")
    player.keyboard.press("j")
    wait_for(player, "report.picture < 290")
    player.keyboard.press("k")
    assert not player.evaluate("report.playing")
    player.keyboard.press("l")
    player.keyboard.press("l")
    assert player.evaluate("[report.way, report.speed]") == [1, 2]
    player.keyboard.press("k")
    player.select_option("#speed", "0.25")
    player.keyboard.press("Home")
    seconds = player.evaluate(
        """async () => {
          const begun = performance.now();
          report.play();
          while (report.picture < 12) await new Promise((next) => setTimeout(next, 5));
          report.play(false);
          return (performance.now() - begun) / 1000;
        }"""
    )
    player.select_option("#speed", "1")
    assert seconds >= 12 / 120 / 0.25 * 0.95  # pictures of 120 per second, at a quarter


def test_play_ends_on_the_last_picture(player: Any) -> None:
    player.evaluate("report.show(470)")
    player.keyboard.press(" ")
    wait_for(player, "!report.playing")
    assert at(player) == 480


def test_curves_zoom_in_time_and_the_ruler_follows(player: Any) -> None:
    player.keyboard.press("End")
    player.evaluate("report.show(200)")
    for _ in range(3):
        player.keyboard.press("+")
    first, last = player.evaluate("report.plots.window")
    assert first < 200 < last
    assert last - first == pytest.approx(479 / 8)
    ticks = [int(text) for text in player.inner_text("#ruler").split()]
    assert all(first + 1 <= tick <= last + 1 for tick in ticks)
    assert len(ticks) >= 3
    # What lies in the middle of a plot is the picture of the window's middle.
    box = player.locator("#ruler").bounding_box()
    player.mouse.click(box["x"] + box["width"] / 2, box["y"] + 5)
    assert at(player) == round((first + last) / 2) + 1
    player.keyboard.press("End")  # what is shown stays in the window
    assert player.evaluate("report.plots.window[1]") >= 479 - 1e-6
    player.keyboard.press("0")
    assert player.evaluate("report.plots.window") == [0, 479]


def test_curves_are_hidden_by_their_legend_and_sorted_by_error(player: Any) -> None:
    player.wait_for_selector(".curve path.k-keys", state="attached")  # a flat line is not "visible"
    path = player.locator(".curve path.k-keys").first
    player.locator("#legend button", has_text="keys").click()
    assert path.evaluate("(each) => getComputedStyle(each).display") == "none"
    player.select_option("#order", "error")
    names = player.locator(".curve:visible").evaluate_all(
        "(all) => all.map((e) => e.dataset.shape)"
    )
    errors = player.evaluate(
        """(names) => names.map((name) => {
          const shape = report.plots.rows.find((row) => row.name === name).shape;
          let sum = 0;
          for (let i = 0; i < 480; i++) {
            sum += Math.abs(report.plots.weight(0, shape, i) - report.plots.weight(2, shape, i));
          }
          return sum / 480;
        })""",
        names,
    )
    assert len(names) > 10
    assert errors == sorted(errors, reverse=True)
    assert player.inner_text("#numbers") == "numbers: edited"
    player.select_option("#order", "region")
    player.locator("#legend button", has_text="keys").click()


def test_curves_are_one_stop_of_the_tab_key_and_are_read_out(player: Any) -> None:
    player.locator("#live", has_text="frame").wait_for()  # the page has said where it is
    player.locator(".curve[tabindex='0']").focus()
    first = player.evaluate("document.activeElement.dataset.shape")
    player.keyboard.press("ArrowDown")
    second = player.evaluate("document.activeElement.dataset.shape")
    assert second != first
    assert player.locator(".curve[tabindex='0']").count() == 1
    assert second in player.inner_text("#live")
    player.keyboard.press("ArrowRight")  # and the player still steps
    assert at(player) == 2


def test_the_keys_are_listed(player: Any) -> None:
    keys = player.locator("#keys")
    assert not keys.is_visible()
    player.keyboard.press("?")
    assert keys.is_visible()
    assert "one frame; first, last" in keys.inner_text()
    assert player.locator("#help").get_attribute("aria-expanded") == "true"
    player.locator("#help").click()
    assert not keys.is_visible()
    assert player.locator("#help").get_attribute("aria-expanded") == "false"


def test_buttons_and_links_of_a_part_are_one_stop_of_the_tab_key(page: Any) -> None:
    page.evaluate("document.activeElement.blur()")
    parts = []
    for _ in range(40):
        page.keyboard.press("Tab")
        inside = "document.activeElement.closest('#worst, #transport, #tables')?.id ?? ''"
        if page.evaluate("document.activeElement.matches('button, a')"):
            parts.append(page.evaluate(inside))
        if page.evaluate("document.activeElement === document.body"):
            break
    assert [parts.count(part) for part in ("worst", "transport", "tables")] == [1, 1, 1]
    page.locator("#play").focus()
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.id") == "back"
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    assert page.evaluate("document.activeElement.id") == "loop"
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "loop", "it is gone back to"


def test_two_versions_are_compared_on_the_face(page: Any) -> None:
    page.evaluate("report.show(100)")
    pixels = {}
    for how in ("wipe", "onion", "difference"):
        page.select_option("#other", label="shot.first")
        page.select_option("#how", how)
        pixels[how] = page.evaluate(PIXELS)
    page.select_option("#other", "")
    alone = page.evaluate(PIXELS)
    page.select_option("#which", label="shot.first")
    other = page.evaluate(PIXELS)
    wiped = np.array(pixels["wipe"]).reshape(-1, 3)
    own, theirs = (np.array(each).reshape(-1, 3) for each in (alone, other))
    half = int(np.sqrt(len(own))) // 2
    square = [each.reshape(2 * half, 2 * half, 3) for each in (wiped, own, theirs)]
    assert (square[0][:, : half - 1] == square[1][:, : half - 1]).all()
    assert (square[0][:, half + 1 :] == square[2][:, half + 1 :]).all()
    assert (own != theirs).any(), "the edit opens the jaw"
    onion = np.array(pixels["onion"]).reshape(-1, 3)
    off = np.abs(onion - (own + theirs) / 2).max(axis=1)  # half of each, in bytes
    assert np.mean(off <= 2) > 0.99, "but for edges, where samples differ"
    assert pixels["difference"] != alone


PIXELS = """() => {
  const { viewer } = report;
  const { canvas, gl } = viewer;
  canvas.style.width = canvas.style.height = "120px";
  canvas.style.inset = "auto";
  viewer.draw();
  const read = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, read);
  return [...read].filter((_, i) => i % 4 < 3);
}"""


def test_markers_lie_where_the_solve_takes_them_within_its_residual(player: Any) -> None:
    player.locator("#markers").check()
    away = player.evaluate(
        """() => {
          report.show(333);
          const { points, targets } = report.viewer.marks;
          let sum = 0, known = 0;
          for (let i = 0; i < points.length; i += 3) {
            const [x, y, z] = [0, 1, 2].map((k) => points[i + k] - targets[i + k]);
            if (Number.isFinite(x)) { sum += x * x + y * y + z * z; known++; }
          }
          return [Math.sqrt(sum / known), known];
        }"""
    )
    player.locator("#markers").uncheck()
    assert away[1] > 30
    assert away[0] < 2.0  # the demo's actor is another head: they never meet


def test_a_typed_note_with_a_correction_is_shown_saved_and_made(
    page: Any, reported: Shot, tmp_path: Path
) -> None:
    page.evaluate("delete window.showSaveFilePicker; report.show(199)")
    page.keyboard.press("t")
    page.keyboard.type("close the lips [n p d]")  # letters are not keys here
    page.fill("#noteShape", "jawOpen")
    page.fill("#noteChange", "-0.25")
    column = page.evaluate("report.viewer.face.names.indexOf('jawOpen')")
    shown = page.evaluate(f"[report.viewer.weights[{column}], report.weightsAt(198)[{column}]]")
    before = page.evaluate(f"report.plots.weight(0, {column_of(page)}, 199)")
    assert shown[0] == pytest.approx(before - 0.25, abs=1e-4), "the face does not show it"
    page.fill("#noteFade", "3")
    page.fill("#noteAuthor", "Ada")
    page.click("#noteForm button[type=submit]")
    assert page.locator("#notes li").count() == 2
    assert "on another version" in page.locator("#notes li").first.inner_text()
    with page.expect_download() as got:
        page.click("#save")
    file = tmp_path / got.value.suggested_filename
    got.value.save_as(file)
    assert file.name == "shot.hero.notes.json"
    old, new = read_notes(file).notes
    assert old.text == NOTE["text"], "a note of another version is lost"
    assert (new.frame, new.shape, new.add, new.fade, new.author) == (
        200,
        "jawOpen",
        -0.25,
        3,
        "Ada",
    )
    performance = reported / "shot.hero.usda"
    assert new.version == PerformanceReader(performance).version
    shot = Shot(tmp_path / "copy", reported.rigid, reported.neutral)
    shutil.copytree(reported.folder, shot.folder)
    made = execute(EditSpec(performance=shot / "shot.hero.usda", notes=file))
    assert made.figures["shapes"] == ["jawOpen"]
    names = PerformanceReader(performance).names
    column = names.index("jawOpen")
    edited = PerformanceReader(shot / "shot.hero.usda").edited()[:, column]
    change = edited - PerformanceReader(performance).edited()[:, column]
    assert change[199] == pytest.approx(-0.25, abs=1e-6)
    assert not change[:195].any()
    with pytest.raises(
        InputError, match=r"as noted on another version of shot\.hero\.usda: frame 200"
    ):
        execute(EditSpec(performance=shot / "shot.hero.usda", notes=file))  # not made twice


def column_of(page: Any) -> int:
    return int(page.evaluate("report.plots.rows.find((row) => row.name === 'jawOpen').shape"))


def test_a_drawn_note_keeps_its_place_and_stays_in_the_page(browser: Any, reported: Shot) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    faults: list[str] = []
    page = visit(context.new_page(), reported / "shot.html", faults)
    page.evaluate("report.show(49)")
    page.keyboard.press("d")
    box = page.locator("#facePane").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + box["height"] / 4, middle[1] + 9)
    page.mouse.up()
    page.click("#noteForm button[type=submit]")
    line = page.locator("#facePane .ink polyline")
    assert line.count() == 1
    page.keyboard.press("ArrowRight")
    assert line.count() == 0, "ink is of one frame"
    page.close()
    again = visit(
        context.new_page(), reported / "shot.html", faults
    )  # nothing was saved: it is there
    again.set_viewport_size({"width": 1000, "height": 700})
    again.locator("#notes a", has_text="50").click()
    again.wait_for_selector("#facePane .ink polyline")
    size = again.locator("#facePane").bounding_box()
    drawn = again.locator("#facePane .ink polyline").bounding_box()
    assert drawn["x"] - size["x"] == pytest.approx(size["width"] / 2, abs=4)
    assert drawn["width"] == pytest.approx(size["height"] / 4, abs=6)
    assert not again.locator("#unsaved").is_hidden()
    again.evaluate("localStorage.clear()")
    context.close()
    assert not faults


def test_notes_of_a_file_join_those_of_the_page(page: Any, tmp_path: Path) -> None:
    newer = write_notes(
        tmp_path / "b.json",
        [NOTE | {"text": "better", "made": "2026-02-01"}, {"id": "b2", "frame": 9000, "text": "x"}],
    )
    page.set_input_files("#file", newer)
    page.wait_for_selector("#notes li >> nth=1")
    words = page.inner_text("#notes")
    assert "better" in words
    assert "outside this report" in words
    for name, bad in (
        ("c", {"id": "c"}),
        ("d", {"id": "d", "frame": 9, "made": 5}),
        ("e", {"id": "e", "frame": 9, "strokes": [{"on": "face", "points": [None]}]}),
    ):
        page.set_input_files("#file", write_notes(tmp_path / f"{name}.json", [bad]))
        wait_for(page, f"document.getElementById('fault').textContent.startsWith('{name}.json: ')")
        assert "cannot be read as notes" in page.inner_text("#fault")
    page.reload()
    wait_for(page, "document.querySelectorAll('#notes li').length === 2")
    page.evaluate("localStorage.clear()")


def test_notes_of_two_tabs_are_kept_and_what_was_deleted_stays_so(
    browser: Any, reported: Shot
) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    faults: list[str] = []
    tabs = [visit(context.new_page(), reported / "shot.html", faults) for _ in range(2)]
    for tab, text in zip(tabs, ("of the first", "of the second"), strict=True):
        tab.evaluate("report.show(49)")
        tab.keyboard.press("t")
        tab.keyboard.type(text)
        tab.click("#noteForm button[type=submit]")
    for tab in tabs:
        wait_for(tab, "document.querySelectorAll('#notes li').length === 3")
    tabs[0].locator("#notes li", has_text=NOTE["text"]).get_by_text("Delete").click()
    wait_for(tabs[1], "document.querySelectorAll('#notes li').length === 2")
    tabs[1].reload()
    wait_for(tabs[1], "globalThis.report?.viewer")
    words = tabs[1].inner_text("#notes")
    assert "of the first" in words
    assert "of the second" in words
    assert NOTE["text"] not in words
    tabs[1].set_input_files("#file", str(reported / "shot.hero.notes.json"))
    for tab in tabs:
        wait_for(tab, "document.querySelectorAll('#notes li').length === 3")
    tabs[0].evaluate("localStorage.clear()")
    context.close()
    assert not faults


def test_the_command_that_tunes_a_frame_is_copied(player: Any, reported: Shot) -> None:
    pairs = read_references(reported / "hero.references.usda").frames.tolist()
    free = next(frame for frame in range(2, 480) if frame not in pairs)
    player.evaluate(f"report.show({free - 1})")
    tune = f"usdface tune hero.references.usda --frame {free}"
    assert player.input_value("#command").endswith(f"--frames {free} && {tune}")
    player.evaluate(f"report.show({pairs[3] - 1})")
    player.locator("#live", has_text=f"frame {pairs[3]}").wait_for()
    player.click("#copy")
    wait_for(player, "document.getElementById('live').textContent.startsWith('copied')")
    assert player.inner_text("#live").endswith(
        f"usdface tune hero.references.usda --frame {pairs[3]}"
    )


def test_frames_that_were_noted_become_references(reported: Shot, tmp_path: Path) -> None:
    references = reported / "hero.references.usda"
    old = read_references(references)
    taken = int(old.frames[0])
    notes = [
        NOTE | {"frame": 333, "last": None},
        NOTE | {"id": "p", "frame": taken, "last": None},
        NOTE | {"id": "d", "frame": 222, "done": True},
        NOTE | {"id": "x", "frame": 7000, "last": None},
    ]
    made = execute(
        ReferencesAddSpec(
            performance=reported / "shot.hero.usda",
            references=references,
            out=reported / "second.references.usda",
            notes=write_notes(tmp_path / "n.json", notes),
        )
    )
    new = read_references(reported / "second.references.usda")
    assert new.frames.tolist() == [*old.frames.tolist(), 333]
    assert not new.tuned[-1]
    np.testing.assert_array_equal(new.tuned[:-1], old.tuned)
    np.testing.assert_allclose(new.weights[:-1], old.weights, atol=1e-6)
    reader = PerformanceReader(reported / "shot.hero.usda")
    order = [reader.names.index(name) for name in new.shape_names]
    np.testing.assert_allclose(new.weights[-1], reader.edited()[332][order], atol=1e-6)
    assert any("7000" in note for note in made.notes)
    assert any(f"pairs already: frames {taken}" in note for note in made.notes)


def test_words_can_be_read_in_either_theme(player: Any) -> None:
    for scheme in ("light", "dark"):
        player.emulate_media(color_scheme=scheme)
        ratio = player.evaluate(CONTRAST)
        assert min(ratio.values()) >= 4.5, ratio  # WCAG 2.2, 1.4.3
    player.emulate_media(color_scheme="null")


CONTRAST = """() => {
  const light = (color) => {
    const [r, g, b] = color.match(/[\\d.]+/g).map(Number).map((v) => v / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (each) => {
    for (let at = each; at; at = at.parentElement) {
      const { backgroundColor } = getComputedStyle(at);
      if (!/, 0\\)$|transparent/.test(backgroundColor)) return backgroundColor;
    }
    return "rgb(255, 255, 255)";
  };
  const ratios = {};
  for (const name of ["#verdict strong", "#facts li", "#clock", "#worst small", "#play", "#live",
    "#legend button", ".curve .name", ".region", "#tables td", "#ruler i", "#notes em"]) {
    const each = document.querySelector(name);
    const two = [getComputedStyle(each).color, ground(each)].map(light).sort();
    ratios[name] = (two[1] + 0.05) / (two[0] + 0.05);
  }
  return ratios;
}"""


def test_fingers_find_everything_and_what_plays_stays_in_sight(
    browser: Any, reported: Shot
) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    page = visit(context.new_page(), reported / "shot.html", [])
    page.set_viewport_size({"width": 390, "height": 844})
    small = page.evaluate(
        """[...document.querySelectorAll("button, select, input:not([type=checkbox])")]
          .map((each) => [each.id || each.textContent, each.getBoundingClientRect()])
          .filter(([, box]) => box.height && box.height < 39.5).map(([name]) => name)"""
    )
    play = page.locator("#play").bounding_box()
    sideways = page.evaluate("document.documentElement.scrollWidth")
    context.close()
    assert not small
    assert play["y"] + play["height"] <= 844
    assert sideways <= 390


def test_the_data_of_a_report_are_its_own(reported: Shot) -> None:
    text = (reported / "shot.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    assert [each["kind"] for each in data["curves"]] == ["edited", "solve", "keys", "version"]
    assert data["notes"][0]["text"] == NOTE["text"]
    assert data["heat"]["name"] == "error"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "holds no notes"),
        ("{", "is no valid JSON"),
        ('{"usdface_notes": "2", "notes": []}', "usdface_notes"),
        ('{"usdface_notes": 1, "notes": [{"id": "a", "frame": "x"}]}', "notes 1 -> frame"),
    ],
)
def test_what_is_no_file_of_notes_is_named_before_any_work(
    reported: Shot, tmp_path: Path, monkeypatch, text: str, message: str
) -> None:
    monkeypatch.setattr("usdface.steps.review.report.set_up_shot_baseline", None)
    file = tmp_path / "notes.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        execute(spec_of(reported, notes=(file,), out=tmp_path / "x.html"))


def test_notes_of_a_newer_format_are_refused(reported: Shot, player: Any, tmp_path: Path) -> None:
    file = write_notes(tmp_path / "newer.json", [NOTE], usdface_notes=99)
    message = "has format 99, but this version of usdface reads 1"
    with pytest.raises(InputError, match=message):
        execute(spec_of(reported, notes=(file,), out=tmp_path / "x.html"))
    with pytest.raises(InputError, match=message):
        execute(EditSpec(performance=reported / "shot.hero.usda", notes=file))
    player.set_input_files("#file", str(file))
    wait_for(player, "document.getElementById('fault').textContent.includes('has format 99')")
