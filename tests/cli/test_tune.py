"""`usdface tune` as a user meets it when it cannot start."""

import importlib
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.regenerate import REPOSITORY
from tests.steps.references.test_select import spec as select_spec
from tests.steps.small_shot import PAIRS, Shot
from tests.test_docs import commands
from tests.tuning.small_asset import write_asset
from usdface.cli import main
from usdface.core.locks import TuningLock
from usdface.media.picture.image import read_picture
from usdface.runner.execute import execute
from usdface.specs.commands import TuneSpec
from usdface.specs.references import ReferencesCoverageSpec
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession

pytestmark = pytest.mark.usefixtures("placement_not_drawn")


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(["tune", *arguments])
    return int(stopped.value.code or 0)


def test_the_commands_of_its_page_and_its_help_are_understood(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [*commands(REPOSITORY / "docs" / "tuning.md"), TuneSpec.example]
    opened = [words for words in map(shlex.split, lines) if words[1] == "tune"]
    assert len(opened) >= 2
    for words in opened:
        assert run(*words[2:]) == 2
        assert f"{words[2]}: no such file; check the path" in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["starlette", "uvicorn"])
def test_a_missing_extra_is_named_with_the_line_that_installs_it(
    tmp_path: Path, monkeypatch, capsys, missing: str
) -> None:
    asset = write_asset(tmp_path)
    # Whatever an earlier test imported of either would hide that it is missing.
    ours = ("usdface.tuning", f"{missing}.")
    for name in [name for name in sys.modules if name.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert run(str(asset)) == 2
    said = capsys.readouterr().err
    assert missing in said
    assert "pip install 'usdface[tune]'" in said


def test_a_layer_that_is_no_references_asset_is_refused(tmp_path: Path, capsys) -> None:
    write_asset(tmp_path)
    assert run(str(tmp_path / "rig.usda"), "--no-browser") == 2
    assert "not a references asset" in capsys.readouterr().err


def test_a_port_in_use_is_named_and_the_lock_is_given_back(tmp_path: Path, capsys) -> None:
    asset = write_asset(tmp_path)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        assert run(str(asset), "--no-browser", "--port", port) == 2
    said = capsys.readouterr().err
    assert f"port {port} of this machine cannot be used" in said
    assert not list(tmp_path.glob("*.lock"))


def test_a_second_person_is_told_who_tunes(tmp_path: Path, capsys) -> None:
    asset = write_asset(tmp_path)
    lock = TuningLock(tmp_path / "hero.references.tuned.lock")
    lock.acquire()
    assert run(str(asset), "--no-browser") == 2
    said = capsys.readouterr().err
    holder = json.loads(lock.path.read_text())
    assert f"{holder['user']} on {holder['host']} has been tuning it since" in said
    assert "--take-over" in said
    lock.check()


def test_a_rig_that_lost_shapes_is_named(tmp_path: Path, capsys) -> None:
    asset = write_asset(tmp_path)
    rig = tmp_path / "rig.usda"
    rig.write_text(rig.read_text().replace("smile", "grin"))
    later = time.time() + 10  # USD reads a layer again by its time, and this one was just written
    os.utime(rig, (later, later))
    assert run(str(asset), "--no-browser") == 2
    assert "selected for another rig" in capsys.readouterr().err


def test_a_port_beyond_the_limit_is_refused(tmp_path: Path, capsys) -> None:
    assert run(str(tmp_path / "x.usda"), "--port", "70000") == 2
    assert "port" in capsys.readouterr().err


def test_what_was_tuned_is_in_the_coverage_once_the_page_is_closed(
    shot: Shot, monkeypatch, capsys
) -> None:
    references, picture = shot / "hero.references.usda", shot / "hero.references.coverage.png"
    (shot / "hero.references.tuned.usda").unlink()
    execute(select_spec(shot, out=references, count=PAIRS), overwrite=True)
    before = picture.read_bytes()
    pairs: list[int] = []

    def serve(spec: TuneSpec, *, announce: Callable[[str], None]) -> TuningSession:
        session = TuningSession(spec.references)
        found = session.references
        changes = [Change(k, found.takes[k], int(found.frames[k]), {}, done=True) for k in pairs]
        session.apply(changes, revision=session.revision)
        session.close()
        return session

    monkeypatch.setattr(importlib.import_module("usdface.tuning.serve"), "serve", serve)
    assert run(str(references), "--no-browser", "--json") == 0
    assert picture.name not in capsys.readouterr().out
    assert picture.read_bytes() == before, "nothing was tuned"
    pairs.extend([0, 2])
    assert run(str(references), "--no-browser", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["figures"]["tuned"] == 2
    assert str(picture) in said["outputs"]
    given = {"references": references, "takes": (shot / "shot.clean.take.usda",)}
    execute(ReferencesCoverageSpec(**given, out=shot / "now.png"))
    np.testing.assert_array_equal(read_picture(picture), read_picture(shot / "now.png"))
    pairs.append(1)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("usdface.steps.references.coverage.redraw_coverage", interrupted)
    assert run(str(references), "--no-browser", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["figures"]["tuned"] == 3
    assert any("was not drawn again" in note for note in said["notes"])
