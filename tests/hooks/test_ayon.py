"""AYON's documented interface, by stand-ins where ayon_core would be: it needs its server."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.hooks.loading import HOOKS, load
from tests.steps.small_shot import Shot
from usdface.publish import ReviewOptions
from usdface.usdio.performance import read_weights

api = pytest.importorskip("pyblish.api", reason="needs pyblish-base")
util = pytest.importorskip("pyblish.util", reason="needs pyblish-base")


@pytest.fixture
def ayon_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As much of ayon_core as publish plug-ins meet, behaving as documented."""

    class PublishValidationError(Exception):
        def __init__(self, message, title=None, description=None, detail=None):
            self.message, self.title = message, title
            self.description = description or message
            super().__init__(message)

    class Extractor(api.InstancePlugin):
        order = 2.0

        def staging_dir(self, instance):
            folder = instance.data.setdefault("stagingDir", str(tmp_path / "staging"))
            Path(folder).mkdir(exist_ok=True)
            return folder

    class AYONAddon:
        pass

    class IPluginPaths:
        def get_publish_plugin_paths(self, host_name):
            return []

    content = {
        "ayon_core": {},
        "ayon_core.addon": {"AYONAddon": AYONAddon, "IPluginPaths": IPluginPaths},
        "ayon_core.pipeline": {},
        "ayon_core.pipeline.publish": {
            "Extractor": Extractor,
            "PublishValidationError": PublishValidationError,
        },
    }
    for name, values in content.items():
        module = ModuleType(name)
        module.__dict__.update(values)
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["ayon_core.pipeline"].publish = sys.modules["ayon_core.pipeline.publish"]


@pytest.fixture
def plugins(ayon_core: None) -> list[type]:
    addon = load("ayon/usdface_addon.py").UsdfaceAddon()
    (folder,) = addon.get_publish_plugin_paths("maya")
    assert Path(folder) == HOOKS / "ayon" / "plugins" / "publish"
    assert addon.get_plugin_paths() == {"publish": [folder]}
    found = api.discover(paths=[folder])
    assert len(found) == 3
    return found


def run(shot: Shot, plugins, review: ReviewOptions):
    context = api.Context()
    context.data.update({"usdface": [str(shot / "shot.hero.usda")]})
    context.data.update({"folderPath": "/shots/sh010", "task": "facial"})
    util.collect(context, plugins)
    for instance in context:
        instance.data["usdfaceReview"] = review
    util.validate(context, plugins)
    util.extract(context, plugins)
    return context


def test_a_product_has_what_ayons_integrator_asks_for(shot: Shot, plugins) -> None:
    context = run(shot, plugins, ReviewOptions(rows=1, quality="draft"))
    assert all(result["success"] for result in context.data["results"])
    (instance,) = context
    assert instance.data["productType"] == "facePerformance"
    assert instance.data["productName"] == "shot.hero"
    assert instance.data["folderPath"] == "/shots/sh010"
    by_name = {each["name"]: each for each in instance.data["representations"]}
    assert set(by_name) == {"usd", "sheet"}
    for representation in by_name.values():
        assert set(representation) >= {"name", "ext", "files", "stagingDir"}
        file = Path(representation["stagingDir"]) / representation["files"]
        assert file.is_file()
        assert file.suffix == f".{representation['ext']}"
    assert by_name["sheet"]["tags"] == ["thumbnail"]


def test_what_ayon_copies_stands_alone_under_any_name(shot: Shot, plugins, tmp_path) -> None:
    context = run(shot, plugins, ReviewOptions(sheet=False))
    (usd,) = context[0].data["representations"]
    moved = tmp_path / "sh010_facePerformance_v007.usdc"
    (Path(usd["stagingDir"]) / usd["files"]).rename(moved)
    assert len(read_weights(moved).values) == 480


def test_a_name_that_ayon_refuses_is_made_one_that_it_takes(ayon_core: None) -> None:
    name = load("ayon/plugins/publish/collect_face_performances.py")._product_name
    assert name("Küche 3; rm -rf") == "K_che_3__rm_-rf"


def test_an_error_is_ayons_own_validation_error(shot: Shot, plugins, monkeypatch) -> None:
    import usdface.publish
    from usdface.usdio.validation import Finding

    finding = Finding("error", "usdface:rates", "x.usda </Face>", "no rate; author one")
    monkeypatch.setattr(usdface.publish, "validate_performance", lambda item: (finding,))
    context = api.Context()
    context.data["usdface"] = [str(shot / "shot.hero.usda")]
    util.publish(context, plugins)
    (failed,) = [result for result in context.data["results"] if not result["success"]]
    assert type(failed["error"]).__name__ == "PublishValidationError"
    assert failed["error"].description == "- no rate; author one (usdface:rates, x.usda </Face>)"
