"""Confined to a folder: whatever names something outside is refused, and nothing is executed."""

import os
import shutil
from pathlib import Path

import pytest
import yaml
from pxr import Sdf

from tests.usdio.small_rig import small_rig
from usdface.cli import main
from usdface.core.confinement import ROOT_VARIABLE, check_confined
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.runner.job import run_job
from usdface.runner.state import job_states
from usdface.specs.edits import BakeSpec
from usdface.specs.reading import read_job
from usdface.usdio.rig.write import write_rig

LAYER = "#usda 1.0\n(\n    subLayers = [@%s@]\n)\n"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that work is confined to, with secrets beside it."""
    folder = tmp_path / "root"
    folder.mkdir()
    (tmp_path / "secret.usda").write_text("#usda 1.0\n")
    (folder / "a.usda").write_text("#usda 1.0\n")
    monkeypatch.setenv(ROOT_VARIABLE, str(folder))
    return folder


def bake(performance: Path, out: Path) -> None:
    execute(BakeSpec(performance=performance, out=out))


def test_a_path_that_climbs_out_is_refused(root: Path) -> None:
    with pytest.raises(InputError, match=r"bake: .*secret.usda: lies outside \S+root, at .*secret"):
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


@pytest.mark.parametrize("confined", [True, False])
def test_a_link_to_itself_is_named(
    root: Path, monkeypatch: pytest.MonkeyPatch, confined: bool
) -> None:
    if not confined:
        monkeypatch.delenv(ROOT_VARIABLE)
    for name in ("loop", "l.usda"):
        (root / name).symlink_to(name)
    for performance, out in (("l.usda", "b.usda"), ("a.usda", "l.usda"), ("a.usda", "loop/b.usda")):
        with pytest.raises(InputError, match=r"/l\S*: is a link, or lies behind one, that leads"):
            bake(root / performance, root / out)


@pytest.mark.parametrize("named", ["../secret.usda", "ABSOLUTE"])
def test_a_layer_that_refers_to_something_outside_is_refused(root: Path, named: str) -> None:
    target = str(root.parent / "secret.usda") if named == "ABSOLUTE" else named
    (root / "sly.usda").write_text(LAYER % target)
    with pytest.raises(InputError, match=r"sly.usda: refers to .*secret.usda, which lies outside"):
        bake(root / "sly.usda", root / "b.usda")


def test_all_faults_are_named_at_once(root: Path) -> None:
    spec = BakeSpec(performance=Path("/etc/a.usda"), out=Path("/etc/b.usda"))
    with pytest.raises(InputError) as fault:
        check_confined(spec.named_paths(), root)
    assert "/etc/a.usda" in str(fault.value)
    assert "/etc/b.usda" in str(fault.value)


def test_a_root_that_is_not_there_confines_nothing_and_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        check_confined((), tmp_path / "missing")


def test_a_job_is_confined_by_an_option(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setenv(ROOT_VARIABLE, "")
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
    with pytest.raises(InputError, match="no active SkelAnimation with blendShapeWeights"):
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
    with pytest.raises(InputError, match="no active SkelAnimation"):
        bake(tmp_path / "a.usda", tmp_path / "b.usda")
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("name", ["sly.USDA", "sly.usdz"])
def test_no_name_of_a_layer_escapes_the_look_inside(root: Path, name: str) -> None:
    layer = root / "inside.usda"
    layer.write_text(LAYER % (root.parent / "secret.usda"))
    if name.endswith("z"):
        package = Sdf.ZipFileWriter.CreateNew(str(root / name))
        package.AddFile(str(layer), "inside.usda")
        package.Save()
    else:
        layer.rename(root / name)
    with pytest.raises(InputError, match=r"refers to .*secret.usda, which lies outside"):
        bake(root / name, root / "b.usda")


ASSET = 'def "A"\n{\n    asset x%s\n}\n'


@pytest.mark.parametrize(
    "text",
    [
        'def "A" (\n    references = @../secret.usda@\n)\n{\n}\n',
        'def "A" (\n    payload = @../secret.usda@\n)\n{\n}\n',
        'def "A" (\n    prepend variantSets = "v"\n)\n{\n    variantSet "v" = {\n        "a" (\n'
        "            references = @../secret.usda@\n        ) {\n        }\n    }\n}\n",
        ASSET % " = @../secret.usda@",
        ASSET % ".timeSamples = {1: @../secret.usda@}",
        ASSET % " = @../not-there.mov@",
        'def "A" (\n    references = @file:///etc/secret.usda@\n)\n{\n}\n',
        'def "A" (\n    clips = {\n        dictionary default = {\n'
        "            asset[] assetPaths = [@../secret.usda@]\n"
        '            string primPath = "/A"\n        }\n    }\n)\n{\n}\n',
        '(\n    expressionVariables = {\n        string X = "../secret.usda"\n    }\n)\n'
        'def "A" (\n    references = @`"${X}"`@\n)\n{\n}\n',
    ],
    ids="reference payload variant asset samples absent url clips expression".split(),
)
def test_no_way_of_naming_a_file_in_a_layer_leads_out(root: Path, text: str) -> None:
    (root / "sly.usda").write_text(f"#usda 1.0\n{text}")
    with pytest.raises(InputError, match="which lies outside"):
        bake(root / "sly.usda", root / "b.usda")


@pytest.mark.parametrize(
    "words",
    [
        "validate ../secret.usda",
        "describe ../secret.usda",
        "edits list ../secret.usda",
        "tune ../secret.usda --no-browser",
        "demo --out ../demo",
        "edit ../secret.usda --shape a --add 1 --frames 1-2",
        "bake a.usda --out ../b.usda",
    ],
)
def test_commands_without_a_job_are_confined_too(
    root: Path, words: str, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(root)
    with pytest.raises(SystemExit) as stopped:
        main(words.split())
    assert stopped.value.code == 2
    assert "lies outside" in capsys.readouterr().err
    assert sorted(path.name for path in root.parent.iterdir()) == ["root", "secret.usda"]


def test_a_pipe_is_refused_before_it_is_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.usda")
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputError, match="a pipe or a device"):
        bake(tmp_path / "pipe.usda", tmp_path / "b.usda")
    with pytest.raises(InputError, match="a pipe or a device"):
        read_job(tmp_path / "pipe.yaml")
    job = tmp_path / "job.yaml"
    steps = [{"step": "bake", "performance": "pipe.usda", "out": "b.usda"}]
    job.write_text(yaml.safe_dump({"job": "x", "steps": steps}))
    for look in (run_job, job_states):
        with pytest.raises(InputError, match="a pipe or a device"):
            look(read_job(job))
