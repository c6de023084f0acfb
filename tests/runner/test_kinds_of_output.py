"""Whatever a step writes says what made it: else a job with it would be refused the second time."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.runner.test_job import ran
from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.media.page.face_payload import FacePayload
from usdface.media.page.report_page import ReviewPage, WeightCurves, build_page, read_page_origin
from usdface.runner.execute import execute
from usdface.runner.job import run_job
from usdface.runner.origin import provenance_of
from usdface.runner.state import job_states
from usdface.specs.job import JobSpec
from usdface.specs.performance import MapSpec
from usdface.specs.reading import read_job
from usdface.speech.phones import PhoneTrack, Span
from usdface.speech.track_files import read_phone_track, write_phone_track

MADE = Provenance(
    step="phones", spec='{"text":"\\"a\\" & <b>"}', inputs={"voice ü.wav": "0a" * 32}, version="9"
)
TRACK = PhoneTrack((Span(0.1, 0.4, "AH"),), (Span(0.1, 0.4, "a"),), (), 0.4)


def test_a_job_with_a_report_a_package_and_figures_runs_twice(shot: Shot, monkeypatch) -> None:
    job = shot / "shot.job.yaml"
    data = yaml.safe_load(job.read_text(encoding="utf-8"))
    performance, take = "shot.hero.usda", "shot.clean.take.usda"
    data["steps"] += [
        {"step": "report", "performance": performance, "take": take, "out": "shot.html"},
        {"step": "package", "performance": performance, "out": "shot.usdz"},
        {
            "step": "evaluate",
            "performance": performance,
            "against": "keys.csv",
            "out": "shot.json",
        },
        {"step": "bake", "performance": performance, "out": "shot.baked.usdc"},
    ]
    job.write_text(yaml.safe_dump(data), encoding="utf-8")
    assert ran(shot, monkeypatch) == ["report", "package", "evaluate", "bake"]
    assert {state.state for state in job_states(read_job(job))} == {"done"}
    assert ran(shot, monkeypatch) == []
    (shot / "shot.html").write_text("<html>mine</html>", encoding="utf-8")
    with pytest.raises(InputError, match=r"shot\.html: exists and was not written by usdface"):
        run_job(read_job(job))


def test_outputs_that_differ_in_their_ending_alone_would_share_layers(shot: Shot) -> None:
    given = {
        "take": shot / "shot.clean.take.usda",
        "mapping": shot / "hero.mapping.usdc",
        "rig": shot / "hero.usdc",
        "frames": "1-20",
    }
    before = weights_path(shot / "shot.hero.usda").read_bytes()
    twin = MapSpec.model_validate(given | {"out": shot / "shot.hero.usdc"})
    with pytest.raises(InputError, match=r"shot\.hero\.usda: has the same sublayers as"):
        execute(twin)
    job = JobSpec.model_validate({"job": "twins", "steps": [twin]})
    with pytest.raises(InputError, match=r"map: .*shot\.hero\.usda: has the same sublayers"):
        run_job(job)
    assert weights_path(shot / "shot.hero.usda").read_bytes() == before
    execute(MapSpec.model_validate(given | {"out": shot / "other.usdc"}))


@pytest.mark.parametrize("name", ["a.json", "a.TextGrid"])
def test_phones_say_what_made_them(tmp_path: Path, name: str) -> None:
    if name.endswith("TextGrid"):
        pytest.importorskip("praatio")
    path = tmp_path / name
    write_phone_track(path, TRACK, origin=MADE.metadata)
    assert provenance_of(path) == MADE
    assert TRACK.phones[0] in read_phone_track(path).phones


def test_a_page_says_what_made_it_whatever_stands_in_that(tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    path.write_text(_page(MADE.metadata), encoding="utf-8")
    assert provenance_of(path) == MADE
    path.write_text(_page(None), encoding="utf-8")
    assert provenance_of(path) is None
    path.write_bytes(b"\xff\xfe<meta")
    assert provenance_of(path) is None
    with pytest.raises(InputError, match=re.escape(f"{path}: cannot be read as a page")):
        read_page_origin(path)


def _page(origin: dict[str, object] | None) -> str:
    return build_page(
        ReviewPage(
            title="a",
            verdict=("check", "Check: nothing is known", ""),
            facts=(),
            rate=24.0,
            frames=[1],
            timecodes=[],
            shapes=("x",),
            regions=("brows",),
            curves=(WeightCurves("solve", np.zeros((1, 1))),),
            strips=(),
            worst=(),
            listings=(),
            face=FacePayload({}, b""),
            origin=origin,
        )
    )
