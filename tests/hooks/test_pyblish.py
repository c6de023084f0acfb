"""A real pyblish runs the plug-ins, found through the environment as in a studio."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf

from tests.hooks.loading import HOOKS
from tests.steps.small_shot import Shot
from usdface.publish import ReviewOptions
from usdface.publish.integrate import read_manifest

api = pytest.importorskip("pyblish.api", reason="needs pyblish-base")
util = pytest.importorskip("pyblish.util", reason="needs pyblish-base")


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> list[type]:
    monkeypatch.setenv("PYBLISHPLUGINPATH", str(HOOKS / "pyblish"))
    return api.discover(paths=[str(HOOKS / "pyblish")])


def context_for(shot: Shot, root: Path):
    context = api.Context()
    context.data["usdface"] = [str(shot / "shot.hero.usda")]
    context.data["usdfaceRoot"] = str(root)
    context.data["comment"] = "softer jaw"
    return context


def publish(context, plugins, review: ReviewOptions):
    util.collect(context, plugins)
    for instance in context:
        instance.data["usdfaceReview"] = review
    util.validate(context, plugins)
    util.extract(context, plugins)
    return util.integrate(context, plugins)


def test_every_plug_in_is_found(plugins) -> None:
    assert {plugin.__name__ for plugin in plugins} == {
        "CollectFacePerformances",
        "ValidateFacePerformance",
        "ExtractFacePerformance",
        "IntegrateFacePerformance",
        "DiscardFacePerformance",
    }


def test_a_performance_goes_all_the_way(shot: Shot, tmp_path: Path, plugins) -> None:
    root = tmp_path / "publish"
    review = ReviewOptions(rows=1, quality="draft")
    context = publish(context_for(shot, root), plugins, review)
    assert all(result["success"] for result in context.data["results"])
    (instance,) = context
    assert (instance.data["frameStart"], instance.data["frameEnd"]) == (1, 480)
    published = instance.data["usdfacePublished"]
    assert published.folder == root / "shot.hero" / "v001"
    assert read_manifest(published.folder)["comment"] == "softer jaw"
    assert published.files["sheet"].stat().st_size > 1000
    again = publish(context_for(shot, root), plugins, review)
    assert not again[0].data["usdfacePublished"].is_new


def test_an_error_stops_the_publish_and_says_how_to_mend_it(
    shot: Shot, tmp_path: Path, plugins
) -> None:
    layer = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.weights.usdc"))
    animation = layer.rootPrims[0].nameChildren["FaceSolve"].path
    layer.SetTimeSample(animation.AppendProperty("blendShapeWeights"), 7, [0.5])
    layer.Save()
    context = context_for(shot, tmp_path)
    context = util.publish(context, plugins)
    failed = [result for result in context.data["results"] if not result["success"]]
    assert [result["plugin"].__name__ for result in failed] == ["ValidateFacePerformance"]
    assert "weights" in str(failed[0]["error"])
    assert not list(tmp_path.glob("shot.hero"))


def test_what_was_extracted_and_not_integrated_is_removed(
    shot: Shot, tmp_path: Path, plugins, monkeypatch
) -> None:
    import usdface.publish

    def broken(extracted, *, comment):
        raise OSError("the disk is gone")

    monkeypatch.setattr(usdface.publish, "integrate_performance", broken)
    context = publish(context_for(shot, tmp_path), plugins, ReviewOptions(sheet=False))
    failed = [result for result in context.data["results"] if not result["success"]]
    assert [result["plugin"].__name__ for result in failed] == ["IntegrateFacePerformance"]
    assert list((tmp_path / "shot.hero").iterdir()) == []


def test_the_environment_file_is_all_that_a_shell_needs(shot: Shot, tmp_path: Path) -> None:
    """In a new process, with nothing but what the file sets: hooks, schemas and validators."""
    script = (
        "import pyblish.api, os; from pxr import Usd, UsdValidation;"
        "print(len(UsdValidation.ValidationRegistry().GetValidatorMetadataForKeyword('usdface')));"
        "print(sorted(each.__name__ for each in pyblish.api.discover()));"
        "print(Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('FaceTakeAPI') is not None)"
    )
    lines = f'. "{HOOKS}/environment.sh"; . "{HOOKS}/environment.sh"; exec "$0" -c "$1"'
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYB", "PXR"))}
    ran = subprocess.run(
        ["bash", "-c", lines, sys.executable, script],
        env=clean,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "CollectFacePerformances" in ran.stdout
    assert ran.stdout.splitlines()[0] == "11"
    assert ran.stdout.splitlines()[-1] == "True"
