"""AYON's interface, by stand-ins made after ayon-core 1.9: the real one needs its server."""

import importlib
import re
import shutil
import sys
import tempfile
import textwrap
from fractions import Fraction
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tests.edited_weights import read_weights
from tests.hooks.loading import HOOKS, load
from tests.regenerate import REPOSITORY
from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.publish import Extracted, ReviewOptions

api = pytest.importorskip("pyblish.api", reason="needs pyblish-base")
util = pytest.importorskip("pyblish.util", reason="needs pyblish-base")


@pytest.fixture
def ayon_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As much of ayon_core as publish plug-ins meet, behaving as documented."""

    class PublishError(Exception):
        def __init__(self, message, title=None, description=None, detail=None):
            self.message, self.title, self.detail = message, title, detail
            self.description = description or message
            super().__init__(message)

    class PublishValidationError(PublishError):
        pass

    class Extractor(api.InstancePlugin):
        order = 2.0

        def staging_dir(self, instance):
            if not instance.data.get("stagingDir"):
                instance.data["stagingDir"] = tempfile.mkdtemp(dir=tmp_path)
                instance.data["stagingDir_persistent"] = False
            return instance.data["stagingDir"]

    class AYONAddon:
        enabled = True

        def __init__(self, manager, settings):
            self.manager = manager

    class IPluginPaths:
        def get_plugin_paths(self):
            return {}

        def get_publish_plugin_paths(self, host_name):
            return []

    content = {
        "ayon_core": {},
        "ayon_core.addon": {"AYONAddon": AYONAddon, "IPluginPaths": IPluginPaths},
        "ayon_core.pipeline": {},
        "ayon_core.pipeline.publish": {
            "Extractor": Extractor,
            "PublishError": PublishError,
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
    addon = load("ayon/usdface_addon.py").UsdfaceAddon(None, {})
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
    assert instance.data["source"] == str(shot / "shot.hero.usda")
    by_name = {each["name"]: each for each in instance.data["representations"]}
    assert set(by_name) == {"usd", "sheet"}
    for representation in by_name.values():
        assert set(representation) >= {"name", "ext", "files", "stagingDir"}
        file = Path(representation["stagingDir"]) / representation["files"]
        assert file.is_file()
        assert file.suffix == f".{representation['ext']}"
    assert by_name["sheet"]["outputName"] == "sheet"  # AYON's own thumbnail is a .jpg, too


def test_the_sheet_is_what_ayon_uploads_as_thumbnail(shot: Shot, plugins) -> None:
    """A tag alone makes none: ayon-core takes `thumbnailPath`, or a representation of that name."""
    (instance,) = run(shot, plugins, ReviewOptions(rows=1, quality="draft"))
    assert Path(instance.data["thumbnailPath"]).name == "shot.hero.sheet.jpg"
    assert Path(instance.data["thumbnailPath"]).is_file()


def test_ayon_can_remove_all_that_was_staged(shot: Shot, plugins, tmp_path: Path) -> None:
    (instance,) = run(shot, plugins, ReviewOptions(sheet=False))
    (representation,) = instance.data["representations"]
    assert Path(instance.data["stagingDir"]).parent == tmp_path
    assert Path(instance.data["stagingDir"]) in Path(representation["stagingDir"]).parents


def test_a_movie_is_what_is_reviewed_in_ayon(ayon_core: None, tmp_path: Path) -> None:
    item = SimpleNamespace(first_frame=1, last_frame=45, rate=Fraction(120))
    path = tmp_path / "shot.review.mp4"
    extracted = SimpleNamespace(
        folder=tmp_path, item=item, path=lambda role: path, movie_pictures=9, movie_rate=24.0
    )
    instance = SimpleNamespace(data={})
    plugin = load("ayon/plugins/publish/extract_face_performances.py").ExtractFacePerformance()
    plugin._add(instance, extracted, "movie", "review", ["review", "webreview"])
    (movie,) = instance.data["representations"]
    assert "webreview" in movie["tags"]
    assert (movie["frameStart"], movie["frameEnd"], movie["fps"]) == (1, 9, 24.0)


def test_head_and_controls_are_products_too(ayon_core: None, tmp_path, monkeypatch) -> None:
    files = {role: f"shot.{role}.usdc" for role in ("weights", "head", "controls")}
    item = SimpleNamespace(first_frame=1)
    extracted = Extracted(item, tmp_path, files)
    monkeypatch.setattr("usdface.publish.extract_performance", lambda *_, **__: extracted)
    instance = SimpleNamespace(data={"usdfaceItem": item})
    load("ayon/plugins/publish/extract_face_performances.py").ExtractFacePerformance().process(
        instance
    )
    found = {each["name"]: each for each in instance.data["representations"]}
    assert {name: each["files"] for name, each in found.items()} == {
        "usd": "shot.weights.usdc",
        "head": "shot.head.usdc",
        "controls": "shot.controls.usdc",
    }
    outputs = [each.get("outputName") for each in found.values()]
    assert len(set(outputs)) == 3  # else AYON would give all one name


def test_what_ayon_copies_stands_alone_under_any_name(shot: Shot, plugins, tmp_path) -> None:
    context = run(shot, plugins, ReviewOptions(sheet=False))
    (usd,) = context[0].data["representations"]
    moved = tmp_path / "sh010_facePerformance_v007.usdc"
    (Path(usd["stagingDir"]) / usd["files"]).rename(moved)
    assert len(read_weights(moved).values) == 480


def test_a_name_that_ayon_refuses_is_made_one_that_it_takes(ayon_core: None) -> None:
    name = load("ayon/plugins/publish/collect_face_performances.py")._product_name
    assert name("Küche 3; rm -rf") == "Ku00fcche_3__rm__rf"
    assert name("顔") != name("口")
    assert name("shot.hero") == "shot.hero"
    assert name(".shot.") == "shot"
    assert name("...") == "_"


def test_two_performances_are_not_one_product(shot: Shot, plugins) -> None:
    paths = [shot / name for name in ("a-b.usda", "a_b.usda")]
    for path in paths:
        shutil.copy(shot / "shot.hero.usda", path)
    context = api.Context()
    context.data["usdface"] = [str(path) for path in paths]
    util.collect(context, plugins)
    assert len(context) == 1
    (failed,) = (each["error"] for each in context.data["results"] if each["error"])
    assert "a_b.usda: its product would be a_b, as that of" in str(failed)


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


def test_what_cannot_be_published_is_said_as_ayons_own_error(
    shot: Shot, plugins, tmp_path: Path, monkeypatch
) -> None:
    """AYON shows the words of its own errors; others are faults of a plug-in to it."""
    context = api.Context()
    context.data["usdface"] = [str(tmp_path / "gone.usda")]
    util.collect(context, plugins)
    (failed,) = [result for result in context.data["results"] if not result["success"]]
    assert type(failed["error"]).__name__ == "PublishError"
    assert "gone.usda: no such file; check the path" in str(failed["error"])

    import usdface.publish

    def refuse(*given: object, **options: object) -> None:
        raise InputError("the disk is full")

    monkeypatch.setattr(usdface.publish, "extract_performance", refuse)
    context = run(shot, plugins, ReviewOptions(sheet=False))
    (failed,) = [result for result in context.data["results"] if not result["success"]]
    assert type(failed["error"]).__name__ == "PublishError"
    assert str(failed["error"]) == "the disk is full"


def test_the_folder_is_an_addons_client_folder(ayon_core: None, tmp_path, monkeypatch) -> None:
    shutil.copytree(HOOKS / "ayon", tmp_path / "ayon_usdface")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = importlib.import_module("ayon_usdface")
    for name in ("ayon_usdface", "ayon_usdface.usdface_addon"):
        monkeypatch.delitem(sys.modules, name)
    assert issubclass(found.UsdfaceAddon, sys.modules["ayon_core.addon"].AYONAddon)
    (folder,) = found.UsdfaceAddon(None, {}).get_publish_plugin_paths("maya")
    assert Path(folder) == tmp_path / "ayon_usdface" / "plugins" / "publish"


def test_the_documented_addon_has_what_ayons_server_asks_for() -> None:
    """The server imports `server` of an add-on and asks for its class."""
    page = (REPOSITORY / "docs/publish.md").read_text(encoding="utf-8")
    (files,) = re.findall(r"```python\n   # package\.py(.*?)```", page, flags=re.DOTALL)
    package, server = textwrap.dedent(files).split("# __init__.py in the folder server")
    values: dict[str, str] = {}
    exec(package, values)
    assert (values["name"], values["client_dir"]) == ("usdface", "ayon_usdface")
    addons = ModuleType("ayon_server.addons")
    addons.BaseServerAddon = type("BaseServerAddon", (), {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "ayon_server", ModuleType("ayon_server"))
        patch.setitem(sys.modules, "ayon_server.addons", addons)
        made: dict[str, object] = {}
        exec(server, made)
    assert issubclass(made["UsdfaceAddon"], addons.BaseServerAddon)
