"""Toolkit's hook interface, by stand-ins made after tk-multi-publish2 2.10 as it ran."""

import hashlib
import json
import logging
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tests.hooks.loading import load
from tests.steps.small_shot import Shot
from usdface.publish.integrate import read_manifest
from usdface.usdio.performance.read import PerformanceReader


class Item:
    """An item of the publisher's tree."""

    def __init__(self, kind: str = "", name: str = "", parent: "Item | None" = None) -> None:
        self.type_spec, self.name, self.parent = kind, name, parent
        self.properties: dict[str, object] = {}
        self.local_properties: dict[str, object] = {}
        self.context = "Shot sh010, Facial"
        self.description = "softer jaw"
        self.children: list[Item] = []
        self.thumbnail = ""

    def create_item(self, kind: str, display: str, name: str) -> "Item":
        self.children.append(Item(kind, name, self))
        return self.children[-1]

    def set_thumbnail_from_path(self, path: str) -> None:
        self.thumbnail = path

    def get_property(self, name: str) -> object:
        return self.local_properties.get(name, self.properties.get(name))

    def saved(self) -> "Item":
        """The item as another process gets it: what a publisher's tree keeps is JSON."""
        other = Item(self.type_spec, self.name, self.parent)
        other.properties = json.loads(json.dumps(self.properties))
        other.local_properties = json.loads(json.dumps(self.local_properties))
        return other


class Server:
    """What is registered, in the order in which it was."""

    def __init__(self) -> None:
        self.publishes: list[dict[str, object]] = []
        self.finalized: list[str] = []
        self.is_down = False

    def get_conflicting_publishes(self, context, path, publish_name, filters=None):
        return [
            each for each in self.publishes if (each["path"], each["name"]) == (path, publish_name)
        ]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    """Toolkit with the app's own hooks beneath ours, and the server that they register at."""
    known = Server()

    class Base:
        logger = logging.getLogger("toolkit")
        parent = SimpleNamespace(util=known)

        settings = {"File Types": {"type": "list", "default": []}}  # noqa: RUF012

        def process_file(self, settings, parent_item, path):
            item = parent_item.create_item("file.unknown", "File", Path(path).name)
            item.properties |= {"path": path, "publish_templates": {}}
            return item

        def publish(self, settings, item):
            if known.is_down:
                raise ConnectionError("the server is down")
            assert isinstance(item.parent.properties, dict)
            if item.get_property("path") != item.get_property("publish_path"):
                shutil.copyfile(item.get_property("path"), item.get_property("publish_path"))
            names = ("type", "name", "version", "path", "dependencies")
            told = {name: item.get_property(f"publish_{name}") for name in names}
            told |= {"id": len(known.publishes) + 1, "thumbnail": item.thumbnail}
            known.publishes.append(told)
            item.properties["sg_publish_data"] = told

        def finalize(self, settings, item):
            known.finalized.append(item.properties["sg_publish_data"]["name"])
            assert item.properties["path"]

    sgtk = ModuleType("sgtk")
    sgtk.get_hook_baseclass = lambda: Base
    monkeypatch.setitem(sys.modules, "sgtk", sgtk)
    return known


def settings(root: Path | str) -> dict[str, SimpleNamespace]:
    values = {"Publish Root": str(root), "Sheet": False, "File Type": "USD Face Performance"}
    return {name: SimpleNamespace(value=value) for name, value in values.items()}


def collected(shot: Shot, name: str) -> Item:
    collector = load("tk-multi-publish2/collect_face_performance.py").FacePerformanceCollector()
    return collector.process_file({}, Item(), str(shot / name))


def publish(shot: Shot, root: Path) -> Item:
    """Collect, publish and finalize, each in a process of its own."""
    plugin = load("tk-multi-publish2/publish_face_performance.py").FacePerformancePublishPlugin
    item = collected(shot, "shot.hero.usda").saved()
    assert plugin().accept(settings(root), item)["accepted"]
    assert plugin().validate(settings(root), item) is True
    plugin().publish(settings(root), item)
    item = item.saved()
    plugin().finalize(settings(root), item)
    return item


def test_performances_become_items_and_other_files_stay_files(shot: Shot, server: Server) -> None:
    assert collected(shot, "shot.hero.usda").type_spec == "usdface.performance"
    for other in ("hero.usdc", "shot.take.usda", "keys.csv"):
        assert collected(shot, other).type_spec == "file.unknown"


def test_a_version_is_made_and_registered_with_what_it_depends_on(
    shot: Shot, tmp_path: Path, server: Server
) -> None:
    plugin = load("tk-multi-publish2/publish_face_performance.py").FacePerformancePublishPlugin()
    assert plugin.item_filters == ["usdface.performance"]
    assert {"File Types", "Publish Root"} <= set(plugin.settings)
    publish(shot, tmp_path)
    (told,) = server.publishes
    assert told["path"] == str(tmp_path / "shot.hero" / "v001" / "shot.hero.usda")
    assert (told["name"], told["version"]) == ("shot.hero", 1)
    assert told["type"] == "USD Face Performance"
    resolved = [Path(path).resolve() for path in told["dependencies"]]
    assert resolved == [
        (shot / "hero.usdc").resolve(),
        (shot / "shot.clean.take.usda").resolve(),
    ]
    assert server.finalized == ["shot.hero"]


def test_the_base_class_leaves_the_version_as_it_was_made(
    shot: Shot, tmp_path: Path, server: Server
) -> None:
    """It copies an item's file to where it is published, over a layer with other references."""
    publish(shot, tmp_path)
    version = tmp_path / "shot.hero" / "v001"
    for file in read_manifest(version)["files"].values():
        found = hashlib.sha256((version / file["name"]).read_bytes()).hexdigest()
        assert found == file["sha256"], file["name"]
    rig, _ = PerformanceReader(version / "shot.hero.usda").rig()
    assert rig.resolve() == (shot / "hero.usdc").resolve()


def test_what_is_published_already_is_not_registered_again(
    shot: Shot, tmp_path: Path, server: Server, caplog
) -> None:
    caplog.set_level(logging.INFO)
    publish(shot, tmp_path)
    item = publish(shot, tmp_path)
    assert len(server.publishes) == 1
    assert server.finalized == ["shot.hero"]
    assert item.properties["sg_publish_data"]["id"] == 1
    assert "v001 is the same already" in caplog.text


def test_a_version_whose_registration_broke_off_is_registered_the_next_time(
    shot: Shot, tmp_path: Path, server: Server
) -> None:
    server.is_down = True
    with pytest.raises(ConnectionError):
        publish(shot, tmp_path)
    server.is_down = False
    publish(shot, tmp_path)
    assert [each["version"] for each in server.publishes] == [1]
    assert server.finalized == ["shot.hero"]


def test_without_a_folder_to_publish_to_nothing_is_valid(shot: Shot, server, caplog) -> None:
    item = collected(shot, "shot.hero.usda")
    plugin = load("tk-multi-publish2/publish_face_performance.py").FacePerformancePublishPlugin()
    assert plugin.validate(settings(""), item) is False
    assert "'Publish Root' is empty" in caplog.text
