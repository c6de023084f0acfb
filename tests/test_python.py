"""`import usdface`: ten names, documented, imported when used."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import usdface
from tests.regenerate import REPOSITORY
from tests.steps.small_shot import Shot

PAGE = REPOSITORY / "docs" / "python.md"


def test_ten_names_and_all_of_them_documented() -> None:
    names = [name for name in usdface.__all__ if name != "__version__"]
    assert len(names) <= 10
    for name in names:
        assert getattr(usdface, name).__doc__
        assert f"`{name}" in PAGE.read_text(encoding="utf-8")
    assert set(names) <= set(dir(usdface))


def test_importing_it_imports_neither_numpy_nor_usd() -> None:
    script = (
        "import sys, usdface; "
        "assert not {'numpy', 'pxr', 'pydantic'} & set(sys.modules), sorted(sys.modules); "
        "usdface.UsdfaceError"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_usd_that_starts_after_it_knows_the_schemas(shot: Shot) -> None:
    script = (
        "import sys, usdface; from pxr import Usd; stage = Usd.Stage.Open(sys.argv[1]); "
        "assert stage.GetDefaultPrim().GetAppliedSchemas() == ['FaceTakeAPI']; "
        "usdface.read_take(sys.argv[1])"
    )
    without = {name: value for name, value in os.environ.items() if name != "PXR_PLUGINPATH_NAME"}
    subprocess.run([sys.executable, "-c", script, shot / "shot.take.usda"], check=True, env=without)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = usdface.nothing


def test_what_is_wrong_with_a_step_is_said(tmp_path: Path) -> None:
    with pytest.raises(usdface.UsdfaceError, match="no step 'mop'"):
        usdface.run_step("mop")
    with pytest.raises(usdface.UsdfaceError, match="take: Field required"):
        usdface.run_step("map", out=tmp_path / "a.usda")


def test_the_documented_script_runs(shot: Shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
    assert "480 frames" in capsys.readouterr().out
