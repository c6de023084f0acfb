"""Confined to a folder: whatever names something outside is refused, and nothing is executed."""

import shutil
from pathlib import Path

import pytest
import yaml
from pxr import Sdf

from tests.usdio.small_rig import small_rig
from usdface.cli import main
from usdface.errors import InputError
from usdface.specs.bake import BakeSpec
from usdface.specs.confinement import VARIABLE, check_confined
from usdface.steps.execute import execute
from usdface.usdio.rig_write import write_rig

LAYER = "#usda 1.0\n(\n    subLayers = [@%s@]\n)\n"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that work is confined to, with secrets beside it."""
    folder = tmp_path / "root"
    folder.mkdir()
    (tmp_path / "secret.usda").write_text("#usda 1.0\n")
    (folder / "a.usda").write_text("#usda 1.0\n")
    monkeypatch.setenv(VARIABLE, str(folder))
    return folder


def bake(performance: Path, out: Path) -> None:
    execute(BakeSpec(performance=performance, out=out))


def test_a_path_that_climbs_out_is_refused(root: Path) -> None:
    with pytest.raises(InputError, match=r"bake: .*secret.usda: lies outside .*, at .*secret"):
        bake(root / ".." / "secret.usda", root / "b.usda")


def test_an_output_outside_is_refused(root: Path) -> None:
    with pytest.raises(InputError, match=r"new\.usda: lies outside"):
        bake(root / "a.usda", root.parent / "new.usda")


def test_a_link_that_leads_out_is_refused(root: Path) -> None:
    (root / "inside.usda").symlink_to(root.parent / "secret.usda")
    with pytest.raises(InputError, match=r"inside.usda: lies outside .* \(by a link\)"):
        bake(root / "inside.usda", root / "b.usda")
    (root / "folder").symlink_to(root.parent)
    with pytest.raises(InputError, match=r"\(by a link\)"):
        bake(root / "a.usda", root / "folder" / "b.usda")


@pytest.mark.parametrize("named", ["../secret.usda", "ABSOLUTE"])
def test_a_layer_that_refers_to_something_outside_is_refused(root: Path, named: str) -> None:
    target = str(root.parent / "secret.usda") if named == "ABSOLUTE" else named
    (root / "sly.usda").write_text(LAYER % target)
    with pytest.raises(InputError, match=r"sly.usda: refers to .*secret.usda, which lies outside"):
        bake(root / "sly.usda", root / "b.usda")


def test_all_faults_are_named_at_once(root: Path) -> None:
    with pytest.raises(InputError) as fault:
        check_confined((BakeSpec(performance=Path("/etc/a.usda"), out=Path("/etc/b.usda")),), root)
    assert "/etc/a.usda" in str(fault.value)
    assert "/etc/b.usda" in str(fault.value)


def test_a_root_that_is_not_there_confines_nothing_and_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        check_confined((), tmp_path / "missing")


def test_a_job_is_confined_by_an_option(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    (tmp_path / "root").mkdir()
    job = tmp_path / "root" / "x.yaml"
    steps = [{"step": "bake", "performance": "../a.usda", "out": "b.usda"}]
    job.write_text(yaml.safe_dump({"job": "x", "steps": steps}))
    for command in ("run", "check"):
        with pytest.raises(SystemExit) as stopped:
            main([command, str(job), "--root", str(tmp_path / "root")])
        assert stopped.value.code == 2
        assert "lies outside" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name",
    ["$(touch owned).usda", "`touch owned`.usda", "a; touch owned;.usda", "| touch owned.usda"],
)
def test_names_with_the_letters_of_a_shell_are_only_names(
    tmp_path: Path, name: str, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.usda", small_rig())
    shutil.copy(tmp_path / "rig.usda", tmp_path / name)
    with pytest.raises(InputError, match="no SkelAnimation with blendShapeWeights"):
        bake(tmp_path / name, tmp_path / "b.usda")
    with pytest.raises(SystemExit):
        main(["validate", name])
    assert not (tmp_path / "owned").exists()


def test_a_layer_that_carries_code_is_data(tmp_path: Path) -> None:
    layer = Sdf.Layer.CreateNew(str(tmp_path / "a.usda"))
    layer.customLayerData = {
        "usdface": {"schema": 1, "version": "1", "step": "__import__('os').system('touch owned')"}
    }
    layer.Save()
    with pytest.raises(InputError, match="no SkelAnimation"):
        bake(tmp_path / "a.usda", tmp_path / "b.usda")
    assert not (tmp_path / "owned").exists()
