"""Markers dragged on the page: the correction in its layer, taken back, and what is refused."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import chromium
from tests.steps.small_shot import Shot
from tests.tuning.test_page import Command, Page
from usdface.core.errors import InputError
from usdface.core.sidecars import corrected_path
from usdface.tuning.session import TuningSession
from usdface.tuning.targets import correct_place, find_targets
from usdface.usdio.layers import read_provenance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.placement import read_placement

WHERE = "tune.placing.names.indexOf('nose_tip')"
ON_PAGE = f"""(() => {{
  const box = tune.viewer.canvas.getBoundingClientRect();
  const i = 3 * {WHERE};
  const [x, y] = tune.viewer.project(...tune.placing.points.subarray(i, i + 3));
  return [x + box.left, y + box.top];
}})()"""

MARKERS_ON_PAGE = """(() => {
  const box = tune.viewer.canvas.getBoundingClientRect();
  const targets = tune.residual.target(tune.state.current);
  return tune.residual.names.flatMap((_, i) => {
    const [x, y] = tune.viewer.project(...targets.subarray(3 * i, 3 * i + 3));
    return [x + box.left, y + box.top];
  });
})()"""


@pytest.fixture
def asset(shot: Shot) -> Path:
    return shot / "hero.references.usda"


@pytest.fixture
def page(asset: Path) -> Iterator[tuple[Command, Page, Any]]:
    command = Command(asset)
    with chromium() as browser:
        context = browser.new_context(viewport={"width": 1280, "height": 760})
        opened = Page(context, command.link)
        opened.wait("!!tune.placing")
        yield command, opened, opened.page.mouse
        context.close()
    command.interrupt()


def marker_place(asset: Path, marker: str) -> np.ndarray:
    references = read_references(asset)
    assert references.placement is not None
    rig = read_rig(references.rig_file, prim=references.rig_prim)
    binding = read_placement(references.placement, rig).binding
    at = binding.places.positions(rig_surfaces(rig)[0].mesh.points)
    return np.asarray(at[binding.names.index(marker)])


@pytest.mark.slow
def test_a_marker_dragged_on_the_face_is_corrected_in_its_layer_and_taken_back(
    asset: Path, page: tuple[Command, Page, Any]
) -> None:
    _, opened, mouse = page
    before = marker_place(asset, "nose_tip")
    opened.page.keyboard.press("k")
    opened.wait("tune.placing.on && !!tune.viewer.view")
    time.sleep(1.0)  # software rendering: the face at rest must have been drawn
    x, y = opened.page.evaluate(ON_PAGE)
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 12, y - 4)
    mouse.move(x + 24, y - 8)
    mouse.up()
    opened.wait(f"tune.placing.corrected[{WHERE}]")
    shown = opened.page.evaluate(
        f"Array.from(tune.placing.points.subarray(3 * {WHERE}, 3 * {WHERE} + 3))"
    )
    after = marker_place(asset, "nose_tip")
    np.testing.assert_allclose(after, shown, atol=0.05)
    assert 2.0 < np.linalg.norm(after - before) < 40.0
    assert after[0] > before[0] + 1.0  # to the right on the screen: the character's left
    under = opened.page.evaluate(ON_PAGE)
    np.testing.assert_allclose(under, [x + 24, y - 8], atol=3.0)  # where it was dropped
    references = read_references(asset)
    assert references.placement is not None
    made = read_provenance(corrected_path(references.placement))
    assert made is not None
    assert made.step == "tune"
    mouse.dblclick(*under)
    opened.wait(f"!tune.placing.corrected[{WHERE}]")
    np.testing.assert_allclose(marker_place(asset, "nose_tip"), before, atol=0.05)
    mouse.move(x, y)
    mouse.down()
    mouse.move(5, y)  # straight to a place beside the face
    mouse.up()
    time.sleep(0.5)
    assert not opened.page.evaluate(f"tune.placing.corrected[{WHERE}]")
    opened.page.keyboard.press("k")  # off again: a drag turns the face
    opened.page.keyboard.press("1")
    yaw = opened.page.evaluate("tune.viewer.camera.yaw")
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 40, y)
    mouse.up()
    assert opened.page.evaluate("tune.viewer.camera.yaw") != yaw
    np.testing.assert_allclose(marker_place(asset, "nose_tip"), before, atol=0.05)
    assert not opened.faults


@pytest.mark.slow
def test_a_part_is_solved_again_while_sliders_that_were_set_hold(
    page: tuple[Command, Page, Any],
) -> None:
    _, opened, _ = page
    title = opened.page.locator("summary", has_text="mouth")
    names = opened.page.evaluate("tune.state.names")
    mouth = [names.index(each) for each in title.locator("..").locator(".label").all_inner_texts()]
    before = np.array(opened.page.evaluate("[...tune.state.row()]"))
    for shape in mouth:
        opened.type_weight(names[shape], 0.9)
    opened.page.evaluate(f"tune.state.reset({mouth[1:]})")
    for shape in mouth[2:]:
        opened.page.evaluate(f"tune.state.putSolved(new Map([[{shape}, 0.9]]), 0)")
    far = opened.page.evaluate("tune.millimetres")
    title.locator("button", has_text="Solve").click()
    message = opened.page.locator("#message")
    message.filter(has_text="mouth is solved for the markers; kept").wait_for()
    row = np.array(opened.page.evaluate("[...tune.state.row()]"))
    rest = [shape for shape in range(len(names)) if shape not in mouth]
    assert row[mouth[0]] == pytest.approx(0.9, abs=1e-6), "set by hand"
    np.testing.assert_array_equal(row[rest], before[rest])
    assert opened.page.evaluate("tune.millimetres") < far - 0.1
    opened.page.keyboard.press("Control+z")
    again = opened.page.evaluate("[...tune.state.row()]")
    assert again[mouth[2]] == pytest.approx(0.9, abs=1e-6), "one step back"
    for shape in mouth:
        opened.type_weight(names[shape], 0.8)
    title.locator("button", has_text="Solve").click()
    message.filter(has_text="Every slider of the mouth is set by hand").wait_for()
    set_meanwhile = f"""async () => {{
      tune.state.reset({mouth});
      const solved = tune.solve({mouth}, "mouth");
      tune.state.slide({mouth[1]}, 0.7);
      await solved;
    }}"""
    opened.page.evaluate(set_meanwhile)
    row = np.array(opened.page.evaluate("[...tune.state.row()]"))
    assert row[mouth[1]] == pytest.approx(0.7, abs=1e-6), "a slider moved while it was solved"
    opened.saved()
    assert not opened.faults


@pytest.mark.slow
def test_a_proposal_is_judged_by_its_residual_and_a_key_is_not(
    page: tuple[Command, Page, Any],
) -> None:
    _, opened, _ = page
    opened.page.set_viewport_size({"width": 1600, "height": 1000})
    count = opened.page.evaluate("tune.state.pairs.length")
    # As selected: nobody has tuned any of them.
    opened.page.evaluate("tune.state.weights.set(tune.state.proposals)")
    opened.page.evaluate("tune.state.done.fill(false); tune.state.go(1)")
    off = [opened.page.evaluate(f"tune.film.residual({n}).get('')") for n in range(count)]
    far = int(np.argmax(off))
    opened.page.evaluate(f"tune.state.go({far})")
    table, sieve = opened.page.locator("#residual"), opened.page.locator("#sieve")
    assert table.locator("caption").inner_text() == "Residual of the proposal, mm RMS"
    assert not table.locator("tfoot").is_visible()
    judged = opened.page.evaluate("[...tune.residual.colors]")
    sieve.select_option("off ")
    shown = opened.page.locator(".tile:visible").count()
    assert shown == sum(mm > 1 for mm in off) > 0
    opened.page.keyboard.press("d")
    assert table.locator("caption").inner_text() == "Distance of markers, mm RMS"
    assert "Not an error of keys" in table.locator("tfoot").inner_text()
    assert opened.page.locator(".tile:visible").count() == shown - 1
    colors = np.reshape(opened.page.evaluate("[...tune.residual.colors]"), (-1, 3))
    assert (colors[:, 0] <= colors[:, 2]).all(), "no red: how far, not how good"
    assert len(table.locator("tbody td:not(.bar)").all()) == len(table.locator("tbody tr").all())
    opened.page.set_viewport_size({"width": 1280, "height": 720})
    box = table.bounding_box()
    assert box is not None
    time.sleep(1.0)  # software rendering: the face in the new window must have been drawn
    shown_at = np.reshape(opened.page.evaluate(MARKERS_ON_PAGE), (-1, 2))
    low = np.array([box["x"], box["y"]])
    high = low + np.array([box["width"], box["height"]])
    covered = np.all((shown_at > low) & (shown_at < high), axis=1)
    assert not covered.any(), "no marker is under the table"
    opened.page.keyboard.down("b")
    assert table.locator("caption").inner_text() == "Residual of the proposal, mm RMS"
    assert opened.page.evaluate("[...tune.residual.colors]") == judged
    opened.page.keyboard.up("b")
    assert not opened.faults


def test_places_off_the_face_and_unknown_markers_are_refused_and_nothing_is_written(
    asset: Path,
) -> None:
    session = TuningSession(asset, author="kim")
    try:
        references = session.references
        rig = read_rig(references.rig_file, prim=references.rig_prim)
        assert references.placement is not None
        layer = corrected_path(references.placement)
        before = layer.read_bytes()
        with pytest.raises(InputError, match="mm off the rig"):
            correct_place(session, rig, "nose_tip", (0.0, 0.0, 900.0))
        with pytest.raises(InputError, match="binds no marker 'nobody'"):
            correct_place(session, rig, "nobody", tuple(marker_place(asset, "nose_tip").tolist()))
        assert layer.read_bytes() == before
        near = marker_place(asset, "nose_tip") + np.array([0.0, 3.0, 0.0])
        correct_place(session, rig, "nose_tip", tuple(near.tolist()))
        targets = find_targets(references, rig)
        row = targets.names.index("nose_tip")
        assert targets.corrected[row]
        assert sum(targets.corrected) == 1
        assert read_placement(references.placement, rig).authors == {"nose_tip": "kim"}
        np.testing.assert_allclose(targets.rest[row], marker_place(asset, "nose_tip"), atol=0.05)
    finally:
        session.lock.release()


def test_a_marker_corrected_while_others_are_measured_is_not_shown_at_its_old_place(
    asset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from usdface.tuning import application
    from usdface.tuning.pictures import PairPictures

    session = TuningSession(asset)
    try:
        references = session.references
        rig = read_rig(references.rig_file, prim=references.rig_prim)
        scene = application.Scene(session, rig, [], PairPictures(references, (), ()))
        near = tuple((marker_place(asset, "nose_tip") + np.array([0.0, 3.0, 0.0])).tolist())
        second = [application.SentPlace(marker="nose_tip", at=near)]

        def measure(*given: Any) -> Any:
            found = find_targets(*given)
            if second:
                scene.place(second.pop())  # dropped while the first one was measured
            return found

        monkeypatch.setattr(application, "targets_or_reason", measure)
        assert not isinstance(scene.targets, str)
        assert scene.targets.corrected[scene.targets.names.index("nose_tip")]
        assert scene.targets is scene.targets
    finally:
        session.lock.release()


def test_what_the_page_sends_is_checked(asset: Path) -> None:
    from tests.tuning.test_guard import RIGHTS, Browser
    from usdface.tuning.application import Scene, build_application
    from usdface.tuning.pictures import PairPictures
    from usdface.usdio.references.read import read_pair_notes

    session = TuningSession(asset)
    try:
        references = session.references
        notes = read_pair_notes(asset)
        rig = read_rig(references.rig_file, prim=references.rig_prim)
        scene = Scene(session, rig, notes, PairPictures(references, notes, ()))
        client = Browser(build_application(scene))
        for sent in (b"{", b'{"marker": 3}', b'{"marker": "a", "at": [1, 2]}', b'{"at": null}'):
            assert client.post("/place", content=sent, headers=RIGHTS).status_code == 400
        far = json.dumps({"marker": "nose_tip", "at": [0, 0, 900]})
        answer = client.post("/place", content=far, headers=RIGHTS)
        assert answer.status_code == 422
        assert "off the rig" in answer.json()["reason"]
        for changed, status, said in (
            ({"free": []}, 400, "free"),
            ({"free": ["nobody"]}, 422, "nobody"),
            ({"pair": 4000}, 422, "reload"),
            ({"weights": {"nobody": 1.0}}, 422, "nobody"),
            ({"weights": {references.shape_names[0]: "1"}}, 400, "number"),
        ):
            asked = {"pair": 0, "weights": {}, "free": [references.shape_names[0]]} | changed
            answer = client.post("/solve", content=json.dumps(asked), headers=RIGHTS)
            assert answer.status_code == status
            assert said in answer.json()["reason"]
    finally:
        session.lock.release()
