"""`import usdface`: ten names, documented, imported when used."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
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
    with pytest.raises(usdface.UsdfaceError, match="take: is missing; give it"):
        usdface.run_step("map", out=tmp_path / "a.usda")


def test_the_documented_script_runs(shot: Shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(compile("\n".join(blocks), str(PAGE), "exec"), {})
    assert "480 frames" in capsys.readouterr().out


def test_messages_speak_python(shot: Shot) -> None:
    clean = {"take": shot / "shot.take.usda", "out": shot / "shot.clean.take.usda"}
    assert usdface.run_step("clean", **clean).up_to_date
    with pytest.raises(usdface.UsdfaceError, match=r"choose another out=, or overwrite=True$"):
        usdface.run_step("clean", **clean, max_gap=7)
    with pytest.raises(
        usdface.UsdfaceError, match=r"^sources: give a list, such as \[a, b\] \(got"
    ):
        usdface.run_step("ingest", sources="shot.c3d", out=shot / "b.take.usda")
    with pytest.raises(
        usdface.UsdfaceError, match=r"^neutrall: unknown key; did you mean neutral\?"
    ):
        usdface.run_step("ingest", sources=["shot.c3d"], out=shot / "b.take.usda", neutrall=3)


def test_assets_are_short_to_see_and_asked_by_name(shot: Shot) -> None:
    performance = usdface.read_performance(shot / "shot.hero.usda")
    names = performance.weights.names
    np.testing.assert_array_equal(performance[names[1]], performance.weights.values[:, 1])
    with pytest.raises(KeyError, match=f"did you mean .*{names[1]}"):
        performance[names[1].upper()[:1] + names[1][1:] + "x"]
    take = usdface.read_take(shot / "shot.take.usda")
    assert take.markers is not None
    assert take.markers[take.markers.names[2]].shape == (len(take.markers.positions), 3)
    rig, references = usdface.read_rig(shot / "hero.usdc"), shot / "hero.references.usda"
    for asset in (take, performance, rig, usdface.read_references(references)):
        assert len(repr(asset)) < 1600


def test_tuned_weights_are_given_as_a_table(shot: Shot) -> None:
    file = shot / "hero.references.usda"
    references = usdface.read_references(file)
    frame, shape = int(references.frames[2]), references.shape_names[0]
    for table in ({frame: {shape: 0.625}}, {"frame": [frame], shape: [0.5]}):
        result = usdface.run_step("references-import", references=file, weights=table)
        assert result.outputs
        value = 0.625 if frame in table else 0.5
        assert usdface.read_references(file).weights[2, 0] == pytest.approx(value)
    with pytest.raises(usdface.UsdfaceError, match="no column `frame`"):
        usdface.run_step("references-import", references=file, weights={shape: [0.5]})
    with pytest.raises(usdface.UsdfaceError, match="references"):
        usdface.run_step("references-import", weights={frame: {shape: 0.625}})
