"""What a layer's verdict lets pass: `validate`, publishes, joins."""

import json
from pathlib import Path

import pytest
from pxr import Sdf

from tests.cli.test_commands import run as usdface
from tests.steps.small_shot import Shot
from usdface.api import validate
from usdface.core.errors import InputError
from usdface.core.sidecars import weights_path
from usdface.publish import (
    ReviewOptions,
    collect_performances,
    extract_performance,
    integrate_performance,
    validate_performance,
)
from usdface.publish.integrate import read_manifest
from usdface.runner.execute import execute as run
from usdface.runner.origin import take_of_performance, traced_files
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.retarget import RetargetSpec
from usdface.specs.review import SheetSpec
from usdface.steps.edits.validate import validate_layers
from usdface.steps.inputs.solve_verdict import (
    describe_retarget,
    judge_performance,
    verdict_findings,
)
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import PerformanceReader


def cover(performance: Path, share: float) -> None:
    """Let a performance say that its references cover so much of every frame."""
    layer = Sdf.Layer.FindOrOpen(str(weights_path(performance)))
    place = PerformanceReader(performance).animation.GetPath().AppendProperty("face:coverage")
    for time in layer.ListTimeSamplesForPath(place):
        regions = len(layer.QueryTimeSample(place, time))
        layer.SetTimeSample(place, time, [share] * regions)
    layer.Save()


@pytest.mark.parametrize(
    ("share", "limit", "severity", "code"),
    [
        (1.0, None, None, 0),
        (0.6, None, "warning", 0),
        (0.6, "good", "error", 1),
        (0.1, None, "error", 1),
        (0.1, "bad", "warning", 0),
    ],
)
def test_validate_says_the_verdict(
    shot: Shot, share: float, limit: str | None, severity: str | None, code: int, capsys
) -> None:
    hero = shot / "shot.hero.usda"
    cover(hero, share)
    option = [] if limit is None else ["--worst-verdict", limit]
    assert usdface("validate", str(hero), "--json", *option) == code
    (found,) = json.loads(capsys.readouterr().out)["figures"].values()
    assert [each["severity"] for each in found] == ([] if severity is None else [severity])
    if limit is None:
        assert [each.severity for each in validate(hero)] == [each["severity"] for each in found]
    for each in found:
        assert each["check"] == "usdface:Verdict"
        assert each["where"] == f"{hero} <{PerformanceReader(hero).animation.GetPath()}>"
        assert each["message"].startswith("Do not use: " if share < 0.5 else "Check: ")


def test_a_retargeting_of_what_is_not_to_be_used_is_not_either(shot: Shot, capsys) -> None:
    hero, first, second = (shot / f"{name}.usda" for name in ("shot.hero", "first", "second"))
    for source, out in ((hero, first), (first, second)):
        line = ("retarget", source, "--rig", shot / "hero.usdc", "--out", out)
        assert usdface(*map(str, line)) == 0
    assert "has that verdict too" not in capsys.readouterr().out
    cover(hero, 0.1)
    for each, source in ((first, hero), (second, first)):
        (finding,) = verdict_findings(each)
        assert finding.severity == "error"
        assert (
            f"by names; its source, {source.name}, has that verdict too; correct" in finding.message
        )
        assert open_shot(each).evidence().bad_source == source.name
    hero.unlink()
    assert verdict_findings(first) == []


@pytest.mark.parametrize("way", ["", "../{}/"])
@pytest.mark.parametrize(("step", "field"), [("retarget", "source"), ("bake", "performance")])
def test_files_that_name_each_other_as_their_source_are_judged_once(
    shot: Shot, step: str, field: str, way: str
) -> None:
    folder = way.format(shot.folder.name)
    hero, other = shot / "shot.hero.usda", shot / "other.usda"
    other.write_text(hero.read_text("utf-8"), "utf-8")
    for file, source in ((hero, other), (other, hero)):
        layer = Sdf.Layer.FindOrOpen(str(file))
        made = layer.customLayerData["usdface"]
        spec = json.loads(made["spec"]) | {field: folder + source.name}
        made |= {"step": step, "spec": json.dumps(spec)}
        layer.customLayerData = layer.customLayerData | {"usdface": made}
        layer.Save()
    assert judge_performance(PerformanceReader(hero)) is not None
    assert take_of_performance(hero) is None or step == "bake"
    traced = traced_files(SheetSpec(performance=hero, out=shot / "s.jpg"))
    assert {path.resolve() for path in traced} >= (
        {other.resolve()} if field == "source" else set()
    )


def test_a_retarget_in_a_shot_is_judged_as_one(shot: Shot) -> None:
    hero, out, above = (shot / f"{name}.usda" for name in ("shot.hero", "first", "above"))
    run(RetargetSpec(source=hero, rig=(shot / "hero.usdc",), out=(out,)))
    layer = Sdf.Layer.CreateNew(str(above))
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(out)))
    layer.customLayerData = {}
    layer.subLayerPaths = ["./first.usda"]
    layer.Save()
    assert describe_retarget(above) == describe_retarget(out) == "a retarget by names"
    expected, found = (judge_performance(PerformanceReader(each)) for each in (out, above))
    assert found is not None
    assert found == expected


def test_every_solve_of_a_shot_is_judged(shot: Shot) -> None:
    hero, other = shot / "shot.hero.usda", shot / "other.usda"
    run(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / "hero.usdc",
            out=other,
            prim="/shot/other",
        )
    )
    cover(other, 0.1)
    both = Sdf.Layer.CreateNew(str(shot / "both.usda"))
    both.TransferContent(Sdf.Layer.FindOrOpen(str(hero)))
    both.subLayerPaths = ["./shot.hero.usda", "./other.usda"]
    both.Save()
    (failure,) = validate_layers((shot / "both.usda",)).failures
    assert failure == "1 error in 1 layer"
    found = validate_layers((shot / "both.usda",)).figures[str(shot / "both.usda")]
    (verdict,) = [each for each in found if each["check"] == "usdface:Verdict"]
    assert "</shot/other/" in verdict["where"]


def test_what_is_not_to_be_used_is_published_only_where_the_studio_says_so(
    shot: Shot, tmp_path: Path, monkeypatch
) -> None:
    hero = shot / "shot.hero.usda"
    cover(hero, 0.1)
    (item,) = collect_performances([hero])
    (finding,) = validate_performance(item)
    assert finding.severity == "error"
    assert "USDFACE_WORST_VERDICT=bad accepts it" in finding.message
    monkeypatch.setenv("USDFACE_WORST_VERDICT", "bad")
    (finding,) = validate_performance(item)
    assert finding.severity == "warning"
    extracted = extract_performance(item, tmp_path, review=ReviewOptions(sheet=False))
    said = read_manifest(integrate_performance(extracted).folder)["verdict"]
    assert (said["level"], said["sentence"]) == ("bad", item.verdict.sentence)
    monkeypatch.setenv("USDFACE_WORST_VERDICT", "fair")
    with pytest.raises(InputError, match="USDFACE_WORST_VERDICT=fair: is no verdict"):
        validate_performance(item)


def test_a_join_ends_with_the_verdict_of_the_whole(shot: Shot) -> None:
    made = MapSpec(
        take=shot / "shot.clean.take.usda",
        mapping=shot / "hero.mapping.usdc",
        rig=shot / "hero.usdc",
        out=shot / "whole.usda",
    )
    whole = run(made)
    parts = {"a.usda": "1-240", "b.usda": "241-480"}
    for name, frames in parts.items():
        run(made.model_copy(update={"out": shot / name, "frames": frames}))
    join = JoinSpec(parts=tuple(shot / name for name in parts), out=shot / "joined.usda")
    joined = run(join)
    assert joined.summary.split(" (")[0] == whole.summary.split(" (")[0]
    assert joined.figures["verdict"]["level"] == joined.level == whole.level
    for name in parts:
        cover(shot / name, 0.1)
    joined = run(join, overwrite=True)
    assert joined.summary.startswith("Do not use: ")
    assert joined.notes[-1].startswith("to do: add frames of this take")
