"""The report in a real browser: opened from disk, it shows exactly what was solved."""

import html
import json
import math
import re
import shutil
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf

from tests.media.bar_code import read_number, write_numbered
from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.media.page.report_page import (
    WEIGHT_STEPS,
    Listing,
    ReviewPage,
    WeightCurves,
    build_page,
)
from usdface.model.review.verdict import VERDICT_WORDS
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.review import EvaluateSpec, ReportSpec
from usdface.steps.review import report as review_page
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import PerformanceReader

FRAME = "Number(document.getElementById('clock').textContent.split(/\\s+/).at(-1))"
EARLY_PICTURES = 5
"""By how many pictures the camera of these tests started before the capture."""


def spec_of(shot: Shot, **options: object) -> ReportSpec:
    given = {"height": 180, "baseline": False, "out": shot / "shot.html"} | options
    return ReportSpec(
        performance=shot / "shot.hero.usda", take=shot / "shot.clean.take.usda", **given
    )


def give_video(
    shot: Shot,
    *,
    pictures: int = 120,
    rate: Fraction = Fraction(25),
    offset: float = -EARLY_PICTURES / 25,
    drift: float = 0.0,
) -> None:
    """Give the take a movie whose pictures carry their numbers, begun a little before it."""
    write_numbered(shot / "camera.mp4", list(range(pictures)), base=1 / rate, rate=rate)
    layer = Sdf.Layer.FindOrOpen(str(shot / "shot.clean.take.usda"))
    prim = layer.GetPrimAtPath("/Take")
    video = Sdf.AttributeSpec(prim, "face:video:file", Sdf.ValueTypeNames.Asset)
    video.default = Sdf.AssetPath("./camera.mp4")
    Sdf.AttributeSpec(prim, "face:video:rate", Sdf.ValueTypeNames.Double).default = float(rate)
    for name, value in (("offset", offset), ("drift", drift)):
        kind = Sdf.ValueTypeNames.Double
        Sdf.AttributeSpec(prim, f"face:video:{name}", kind).default = value
    layer.Save()


@pytest.fixture(scope="module")
def keyed(finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory) -> tuple[Shot, StepResult]:
    """A shot, which tests do not change, and its report against keys."""
    folder = tmp_path_factory.mktemp("keyed") / "shot"
    shutil.copytree(finished_shot.folder, folder)
    shot = replace(finished_shot, folder=folder)
    return shot, execute(spec_of(shot, against=shot / "keys.csv", baseline=True, worst=4))


def open_page(browser: Any, file: Path, faults: list[str]) -> Any:
    return visit(browser.new_page(viewport={"width": 1280, "height": 900}), file, faults)


def visit(page: Any, file: Path, faults: list[str]) -> Any:
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
    page.on("request", lambda asked: check_request(asked.url, faults))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    return page


def wait_for(page: Any, condition: str) -> None:
    for _ in range(400):  # not by the page itself, whose policy allows no evaluation
        if page.evaluate(condition):
            return
        page.wait_for_timeout(25)
    raise AssertionError(f"never: {condition}")


def check_request(url: str, faults: list[str]) -> None:
    if not url.startswith(("file:", "blob:", "data:")):
        faults.append(f"asked for {url}")


@pytest.mark.parametrize(
    ("rate", "offset", "drift"),
    [
        pytest.param(Fraction(25), -EARLY_PICTURES / 25, 0.0, marks=pytest.mark.slow),
        (Fraction(30000, 1001), -0.411, 900.0),
    ],
)
def test_each_seek_shows_the_sheets_picture_and_the_weights_of_its_frame(
    shot: Shot, rate: Fraction, offset: float, drift: float, browser: Any
) -> None:
    give_video(shot, rate=rate, offset=offset, drift=drift, pictures=150)
    execute(spec_of(shot, worst=1))
    reader = PerformanceReader(shot / "shot.hero.usda")
    weights = reader.edited()
    faults: list[str] = []
    whole = open_shot(shot / "shot.hero.usda", shot / "shot.clean.take.usda")
    with ShotPictures(whole, height=180, quality="draft") as sheet:
        page = open_page(browser, shot / "shot.html", faults)
        names = page.evaluate("report.viewer.face.names")
        order = [reader.names.index(name) for name in names]
        # Every 24th frame is at the time at which one of 25 pictures per second begins.
        some = np.random.default_rng(0).permutation(470)[:8].tolist()
        for frame in (456, 0, 24, *some):
            got = page.evaluate(SEEK, frame)
            # Every frame of the take, each with the video's picture of its time.
            seen = read_number(np.array(got["pixels"]).reshape(1, -1, 4)[[0] * 41])
            assert seen == math.floor(((frame / 120 - offset) / (1 + drift * 1e-6)) * rate + 1e-6)
            assert seen == read_number(sheet.video(reader.first_frame + frame).pixels)
            assert got["frame"] == reader.first_frame + frame
            np.testing.assert_allclose(
                got["weights"], weights[frame][order], atol=0.51 / WEIGHT_STEPS
            )
        page.close()
    assert not faults


SEEK = """async (picture) => {
  report.show(picture);
  const video = document.getElementById("video");
  const deadline = performance.now() + 20000;
  while (report.seeking || video.seeking || video.readyState < 2) {
    if (performance.now() > deadline) throw new Error("the video does not seek");
    await new Promise((next) => setTimeout(next, 5));
  }
  const canvas = document.createElement("canvas");
  canvas.width = video.videoWidth; canvas.height = video.videoHeight;
  const context = canvas.getContext("2d");
  context.drawImage(video, 0, 0);
  const pixels = [...context.getImageData(0, 40, canvas.width, 1).data];
  const { frames } = JSON.parse(document.getElementById("data").textContent);
  return { pixels, frame: frames[picture], weights: [...report.weightsAt(picture)] };
}"""


def test_the_page_is_worked_by_keyboard_and_by_address(
    keyed: tuple[Shot, StepResult], browser: Any
) -> None:
    shot, report = keyed
    assert len(report.figures["worst_frames"]) == 4
    faults: list[str] = []
    page = open_page(browser, shot / "shot.html", faults)
    page.evaluate("location.hash = '#101'")
    wait_for(page, f"{FRAME} === 101")
    page.keyboard.press("ArrowRight")
    wait_for(page, f"{FRAME} === 102")  # every frame of the take
    wait_for(page, "location.hash === '#102'")  # a link to what is shown
    page.keyboard.press("End")
    wait_for(page, f"{FRAME} === 480")
    worst = report.figures["worst_frames"]
    for _ in range(2):  # again after Home, though the address has not changed
        page.click("#worst a >> nth=0")
        wait_for(page, f"{FRAME} === {worst[0]}")
        page.keyboard.press("Home")
        wait_for(page, f"{FRAME} === 1")
    # The address may come to name the frame before the link just as the link is followed.
    page.evaluate("document.querySelector('#worst a').click(); history.replaceState(0, '', '#1')")
    wait_for(page, f"{FRAME} === {worst[0]}")
    page.keyboard.press("Home")
    for each in sorted(worst):
        page.keyboard.press("n")
        wait_for(page, f"{FRAME} === {each}")
    for each in sorted(worst, reverse=True)[1:]:
        page.keyboard.press("p")
        wait_for(page, f"{FRAME} === {each}")
    still = "document.querySelector('#worst canvas').getContext('2d')"
    drawn = f"new Set({still}.getImageData(0, 0, 128, 128).data).size"
    assert page.evaluate(drawn) > 50, "the moments have no pictures"
    assert page.inner_text("#verdict").split(":")[0] in VERDICT_WORDS.values()
    page.keyboard.press(" ")
    assert page.evaluate("document.getElementById('play').getAttribute('aria-label')") == "Pause"
    page.keyboard.press(" ")
    page.locator("#scrub").focus()
    page.keyboard.press(" ")
    assert page.evaluate("document.getElementById('play').getAttribute('aria-label')") == "Pause"
    page.keyboard.press(" ")
    page.fill("#find", "jawopen")
    rows = page.locator(".curve:visible")
    assert rows.count() == 1
    page.wait_for_selector(".curve:visible path.k-solve")
    assert page.locator("caption h2", has_text="Measured against the keys").count() == 1
    assert page.locator("table:not(:has(caption))").count() == 0
    unnamed = page.locator("button:not([aria-label], :has(img))", has_not_text=re.compile("[a-z]"))
    assert unnamed.count() == 0, "buttons of a sign alone need a name"
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    filled = page.evaluate(
        "(() => { const s = document.getElementById('still'); "
        "const d = s.getContext('2d').getImageData(0, 0, s.width, s.height).data; "
        "return new Set(d).size; })()"
    )
    assert filled > 50, "the face is not on paper"
    page.close()
    assert not faults


def test_nothing_of_the_page_is_outside_a_narrow_window(
    keyed: tuple[Shot, StepResult], browser: Any
) -> None:
    shot, _ = keyed
    page = browser.new_page(viewport={"width": 760, "height": 900})
    page.goto((shot / "shot.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    for width in (760, 480, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(BROKEN) == [], "words and numbers of tables are on two lines"
        scrub = page.evaluate("document.getElementById('scrub').getBoundingClientRect().width")
        assert scrub > width / 2
    page.close()


def test_the_page_and_evaluate_tell_one_error_of_the_weights(
    keyed: tuple[Shot, StepResult], tmp_path: Path
) -> None:
    """Both leave out what markers cannot show: the eyes' directions."""
    shot = keyed[0]
    told = EvaluateSpec(
        performance=shot / "shot.hero.usda", against=shot / "keys.csv", out=(tmp_path / "e.json",)
    )
    error = execute(told).figures["weight_rmse"]
    assert f"<td>{error:.3f}</td>" in (shot / "shot.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_prints_without_one_thing_over_another(shot: Shot, browser: Any) -> None:
    execute(spec_of(shot, worst=12))
    page = browser.new_page(viewport={"width": 794, "height": 1123})  # A4 at 96 dots an inch
    page.goto((shot / "shot.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    boxes = page.evaluate(BOXES)
    links = page.evaluate(
        "(() => { const box = document.querySelector('aside').getBoundingClientRect();"
        "return [...document.querySelectorAll('#worst a')].filter((a) => "
        "a.getBoundingClientRect().bottom <= box.bottom + 1).length; })()"
    )
    cut = page.evaluate(CUT)
    drawn = page.evaluate(
        "[...document.querySelectorAll('.curve')].map((each) => "
        "getComputedStyle(each).contentVisibility)"
    )
    page.emulate_media(media="screen")
    small = page.evaluate(SMALL)
    page.close()
    assert set(drawn) == {"visible"}, "curves below the window are blank on paper"
    assert not small, "letters of less than 12 pixels"
    for (_, bottom), (top, _) in pairwise(boxes):
        assert bottom <= top + 1
    assert not cut, "pictures, timecodes or names are cut off"
    assert links == 12, "frames to look at first are cut off"


BROKEN = """[...document.querySelectorAll("#tables th, #tables td")].filter((cell) => {
  const range = document.createRange();
  range.selectNodeContents(cell);
  const lines = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
  return !/[\\s-]/.test(cell.textContent.trim()) && lines.size > 1;
}).map((cell) => cell.textContent)"""


SMALL = """[...document.querySelectorAll("body *")].filter((each) =>
  [...each.childNodes].some((node) => node.nodeType === 3 && node.data.trim()) &&
  each.getBoundingClientRect().width && parseFloat(getComputedStyle(each).fontSize) < 12
).map((each) => each.textContent)"""


BOXES = """[...document.querySelectorAll("main > *")].map((part) => {
  const inner = [part, ...part.querySelectorAll("figure, aside, .strip, .curve, table, img")];
  const boxes = inner.map((each) => each.getBoundingClientRect()).filter((box) => box.height);
  return [Math.min(...boxes.map((b) => b.top)), Math.max(...boxes.map((b) => b.bottom))];
}).filter(([top, bottom]) => Number.isFinite(top))"""


CUT = """[...document.querySelectorAll("#still, #worst a *, .name")].filter((each) => {
  const [own, around] = [each, each.parentElement].map((e) => e.getBoundingClientRect());
  return each.scrollWidth > each.clientWidth + 1 && each.clientWidth || own.right > around.right + 1
    || each.id === "still" && own.bottom > around.bottom + 1;
}).map((each) => each.id || each.textContent)"""


def test_the_page_tells_what_the_mappings_references_cover(
    keyed: tuple[Shot, StepResult],
) -> None:
    shot, report = keyed
    text = (shot / "shot.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    strip = next(each for each in data["strips"] if each["name"] == "coverage")
    values = np.array(strip["values"])
    assert ((values >= 0) & (values <= 100)).all()
    assert values.max() > 1
    assert "<h2>Coverage by hero.references.usda</h2>" in text
    table = text.split("<h2>Tune next</h2>")[1].split("</table>")[0]
    frames = [int(frame) for frame in re.findall(r'href="#(\d+)"', table)]
    assert set(frames) <= set(data["frames"])
    assert 'alt="Coverage by hero.references.usda"' in text
    assert "<h2>Markers that were repaired</h2>" in text
    assert len(report.figures["worst_frames"]) == len(data["worst"]) == 4
    assert all(each["region"] and each["reason"] for each in data["worst"])


def test_references_that_are_gone_leave_the_coverage_out(shot: Shot) -> None:
    (shot / "hero.references.usda").rename(shot / "elsewhere.usda")
    report = execute(spec_of(shot))
    assert not any("coverage" in note for note in report.notes)
    assert "Coverage by" not in (shot / "shot.html").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="no such file"):
        execute(spec_of(shot, references=shot / "hero.references.usda"), overwrite=True)


def test_nothing_in_the_data_becomes_part_of_the_page(shot: Shot) -> None:
    from usdface.media.page.face_payload import pack_face
    from usdface.usdio.rig.read import read_rig

    evil = "</script><img src=x onerror=alert(1)> @DATA@"
    made = build_page(
        ReviewPage(
            title=evil,
            verdict=("bad", evil, evil),
            facts=(evil,),
            rate=25.0,
            frames=[1],
            timecodes=[evil],
            shapes=(evil,),
            regions=(evil,),
            curves=(WeightCurves("solve", np.zeros((1, 1))),),
            strips=(),
            worst=((0, evil, evil),),
            listings=(Listing(evil, (evil,), ((evil,),), (1,)),),
            face=pack_face(read_rig(shot / "hero.usdc")),
            origin={"usdface": evil, "spec": '">' + evil, "inputs": {evil: evil}},
        )
    )
    assert "<img src=x" not in made
    assert html.escape(evil) in made
    assert made.count("</script>") == len(re.findall(r"<script", made))
    assert "default-src 'none'" in made
    assert "unsafe" not in made.split("<style>")[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": "9000-9100"}, "has no frame in 9000-9100; choose some of "),
        ({"sheet": "hero.usdc"}, r"browsers show only \.jpg"),
    ],
)
def test_what_cannot_be_shown_is_said(shot: Shot, change: dict[str, str], message: str) -> None:
    given = {key: shot / value if key == "sheet" else value for key, value in change.items()}
    with pytest.raises(InputError, match=message):
        execute(spec_of(shot, **given))
    assert not (shot / "shot.html").exists()


def test_a_performance_too_long_for_a_page_is_refused(shot: Shot, monkeypatch) -> None:
    monkeypatch.setattr(review_page, "LONGEST_FRAMES", 100)
    with pytest.raises(InputError, match=r"480 frames are too many.*--frames"):
        execute(spec_of(shot))
