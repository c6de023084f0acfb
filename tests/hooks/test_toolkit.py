"""Toolkit's documented hook interface, by stand-ins: tk-multi-publish2 runs inside its desktop."""

import logging
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tests.hooks.loading import load
from tests.steps.small_shot import Shot


class Item:
    """An item of the publisher's tree."""

    def __init__(self, kind: str = "", name: str = "") -> None:
        self.type, self.name = kind, name
        self.properties: dict[str, object] = {}
        self.local_properties: dict[str, object] = {}
        self.description = "softer jaw"
        self.children: list[Item] = []
        self.thumbnail = ""

    def create_item(self, kind: str, display: str, name: str) -> "Item":
        self.children.append(Item(kind, name))
        return self.children[-1]

    def set_thumbnail_from_path(self, path: str) -> None:
        self.thumbnail = path


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """Toolkit with the app's own hooks beneath ours: what these register."""
    done: list[dict[str, object]] = []

    class Base:
        logger = logging.getLogger("toolkit")

        settings = {"File Types": {"type": "list", "default": []}}  # noqa: RUF012

        def process_file(self, settings, parent_item, path):
            return parent_item.create_item("file.generic", "File", Path(path).name)

        def publish(self, settings, item):
            done.append(dict(item.local_properties))

        def finalize(self, settings, item):
            done.append({"finalized": item.name})

    sgtk = ModuleType("sgtk")
    sgtk.get_hook_baseclass = lambda: Base
    monkeypatch.setitem(sys.modules, "sgtk", sgtk)
    return done


def settings(root: Path | str) -> dict[str, SimpleNamespace]:
    values = {"Publish Root": str(root), "Sheet": False, "File Type": "USD Face Performance"}
    return {name: SimpleNamespace(value=value) for name, value in values.items()}


def collected(shot: Shot, name: str) -> Item:
    collector = load("tk-multi-publish2/collect_face_performance.py").FacePerformanceCollector()
    return collector.process_file({}, Item(), str(shot / name))


def test_performances_become_items_and_other_files_stay_files(shot: Shot, registered) -> None:
    assert collected(shot, "shot.hero.usda").type == "usdface.performance"
    for other in ("hero.usdc", "shot.take.usda", "keys.csv"):
        assert collected(shot, other).type == "file.generic"


def test_a_version_is_made_and_registered_with_what_it_depends_on(
    shot: Shot, tmp_path: Path, registered
) -> None:
    item = collected(shot, "shot.hero.usda")
    plugin = load("tk-multi-publish2/publish_face_performance.py").FacePerformancePublishPlugin()
    assert plugin.item_filters == [item.type]
    assert {"File Types", "Publish Root"} <= set(plugin.settings)
    given = settings(tmp_path)
    assert plugin.accept(given, item)["accepted"]
    assert plugin.validate(given, item) is True
    plugin.publish(given, item)
    plugin.finalize(given, item)
    told, finalized = registered
    assert told["publish_path"] == str(tmp_path / "shot.hero" / "v001" / "shot.hero.usda")
    assert (told["publish_name"], told["publish_version"]) == ("shot.hero", 1)
    assert told["publish_type"] == "USD Face Performance"
    resolved = [Path(path).resolve() for path in told["publish_dependencies"]]
    assert resolved == [
        (shot / "hero.usdc").resolve(),
        (shot / "shot.clean.take.usda").resolve(),
    ]
    assert finalized == {"finalized": "shot.hero"}


def test_without_a_folder_to_publish_to_nothing_is_valid(shot: Shot, registered, caplog) -> None:
    item = collected(shot, "shot.hero.usda")
    plugin = load("tk-multi-publish2/publish_face_performance.py").FacePerformancePublishPlugin()
    assert plugin.validate(settings(""), item) is False
    assert "'Publish Root' is empty" in caplog.text
