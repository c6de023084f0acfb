"""Jobs handed over for real where a farm's client is there, else to one that only writes down."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml

from tests.steps.small_shot import Shot
from tests.usdio.small_rig import small_rig
from usdface.cli import main
from usdface.core.errors import CheckFailedError, InputError
from usdface.farm.plan import FarmStep
from usdface.farm.submit import named_folders, submit
from usdface.specs.commands import SubmitSpec
from usdface.specs.edits import BakeSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.rig.write import write_rig

USDFACE = [sys.executable, "-m", "usdface"]

needs_openjd = pytest.mark.skipif(
    not (Path(sys.executable).with_name("openjd").exists() or shutil.which("openjd")),
    reason="needs the farm extra: openjd-cli",
)


@pytest.fixture
def job(shot: Shot) -> Path:
    """A job that maps the finished shot again, whose name would do harm if it were read."""
    steps = [
        {
            "step": "map",
            "take": "shot.clean.take.usda",
            "mapping": "hero.mapping.usdc",
            "rig": "hero.usdc",
            "out": "again.usda",
        }
    ]
    file = shot / "again.job.yaml"
    name = "{{Param.Nope}} $(touch pwned) 'ü'"
    file.write_text(yaml.safe_dump({"job": name, "steps": steps}), encoding="utf-8")
    return file


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@needs_openjd
def test_chunks_run_here_are_the_whole_and_a_second_run_changes_no_byte(
    job: Path, shot: Shot, capfd
) -> None:
    done = submit(SubmitSpec(job=job, chunk=240))
    told = capfd.readouterr().out
    assert "openjd_progress: 100.0" in told
    assert "openjd_status: join again.usda: joined to frame 480" in told
    whole = read_performance(shot / "shot.hero.usda").weights
    joined = read_performance(shot / "again.usda").weights
    assert np.array_equal(whole.values, joined.values)
    assert (whole.names, whole.first_frame) == (joined.names, joined.first_frame)
    assert not list(shot.folder.rglob("pwned"))
    before = digests(shot.folder)
    again = submit(SubmitSpec(job=job, chunk=240, write_only=True))
    assert again.bundle == done.bundle
    tasks = sorted(done.bundle.glob("tasks/*/*.yaml"))
    assert [task.parent.name for task in tasks] == ["join", "map", "map"]
    for task in tasks:
        with pytest.raises(SystemExit, match="0"):
            main(["run", str(task), "--make-folders"])
        assert ".usda: up to date" in capfd.readouterr().out
    assert digests(shot.folder) == before


@pytest.mark.slow
@needs_openjd
def test_stopping_a_local_run_stops_its_tasks_and_the_next_goes_on(job: Path, shot: Shot) -> None:
    command = [*USDFACE, "submit", str(job), "--chunk", "240"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            if "openjd_status: map again.0001.usda: mapped" in line:
                break
        else:
            pytest.fail("the first task was not told to have mapped")
        process.send_signal(signal.SIGTERM)
        process.stdout.read()
    assert process.returncode == 3
    assert not list(shot.folder.rglob(".*")), "nothing half written stays"
    assert not (shot / "again.usda").exists()
    submit(SubmitSpec(job=job, chunk=240), quiet=True)
    first = digests(shot.folder)
    for made in [*shot.folder.glob("again.*usd*"), shot / "again.parts"]:
        shutil.rmtree(made) if made.is_dir() else made.unlink()
    submit(SubmitSpec(job=job, chunk=240), quiet=True)
    assert digests(shot.folder) == first, "undisturbed, it comes out the same"


@needs_openjd
def test_a_task_that_fails_fails_the_submission(job: Path, shot: Shot, capfd) -> None:
    write_rig(shot / "hero.usdc", small_rig())
    with pytest.raises(CheckFailedError, match="openjd ended with 1"):
        submit(SubmitSpec(job=job))
    assert "openjd_fail: step 1 of 1, map: " in capfd.readouterr().out


def test_a_worker_finds_files_where_its_rules_say(job: Path, shot: Shot, tmp_path: Path) -> None:
    done = submit(SubmitSpec(job=job, chunk=200, write_only=True))
    elsewhere = tmp_path / "mnt"
    shutil.move(shot.folder, elsewhere)
    rule = {
        "source_path_format": "POSIX",
        "source_path": str(shot.folder),
        "destination_path": str(elsewhere),
    }
    rules = tmp_path / "rules.json"
    rules.write_text(json.dumps({"version": "pathmapping-1.0", "path_mapping_rules": [rule]}))
    task = elsewhere / done.bundle.name / "tasks" / "map" / "2.yaml"
    with pytest.raises(SystemExit, match="0"):
        main(["run", str(task), "--path-mapping", str(rules), "--make-folders"])
    part = read_performance(elsewhere / "again.parts" / "again.0002.usda").weights
    assert (part.first_frame, len(part.values)) == (201, 200)


def stand_in(folder: Path, name: str, code: int = 0) -> Path:
    """Put a command into a folder that writes its arguments down."""
    real, said = os.path.realpath(shutil.which("python3") or "/usr/bin/python3"), folder / "said"
    script = folder / name
    script.write_text(
        f"#!{real}\nimport json, sys\njson.dump(sys.argv[1:], open({str(said)!r}, 'w'))\n"
        f"sys.exit({code})\n"
    )
    script.chmod(0o755)
    return said


def test_deadline_is_called_with_a_list_of_arguments(job: Path, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    said = stand_in(tmp_path, "deadline")
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    bundle = tmp_path / "b; touch pwned"
    done = submit(SubmitSpec(job=job, farm="deadline", priority=70, out=bundle))
    assert json.loads(said.read_text()) == [
        *("bundle", "submit", str(done.bundle), "--yes"),
        *("--submitter-name", "usdface", "--known-asset-path", str(job.parent)),
        *("--priority", "70"),
    ]
    assert not list(tmp_path.rglob("pwned"))


def test_deadline_is_told_the_folders_that_the_job_names_and_no_more(tmp_path: Path) -> None:
    def step(performance: str, out: str) -> FarmStep:
        task = BakeSpec(performance=Path(performance), out=Path(out))
        return FarmStep("bake", (task,), ())

    steps = [step("/show/a/x.usda", "/show/a/b/y.usda"), step("/top.usda", "/show/ab/z.usda")]
    assert named_folders(steps) == [Path("/show/a"), Path("/show/ab")]


def test_a_farm_that_refuses_and_a_client_that_is_missing_are_said(
    job: Path, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="deadline: no such command on this machine; install"):
        submit(SubmitSpec(job=job, farm="deadline"))
    monkeypatch.undo()
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    stand_in(tmp_path, "deadline", code=7)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(CheckFailedError, match=r"deadline ended with 7; .*`deadline config`"):
        submit(SubmitSpec(job=job, farm="deadline"))


@pytest.fixture
def pyoutline(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """As much of pyoutline as we call, writing down what it is told."""
    said: dict[str, object] = {"layers": {}, "launched": None}

    class Shell:
        def __init__(self, name: str, **arguments: object) -> None:
            self.name, self.arguments, self.after = name, arguments, []
            said["layers"][name] = self

        def depend_all(self, layer: "Shell") -> None:
            self.after.append(layer.name)

    class Outline:
        def __init__(self, name: str, frame_range: str) -> None:
            said["name"], said["range"] = name, frame_range
            self.layers: dict[str, Shell] = {}

        def add_layer(self, layer: Shell) -> None:
            self.layers[layer.name] = layer

        def get_layer(self, name: str) -> Shell:
            return self.layers[name]

    class OutlineLauncher:
        def __init__(self, outline: Outline, **flags: object) -> None:
            said["flags"] = flags

        def serialize(self, use_pycuerun: bool) -> str:
            assert not use_pycuerun
            return "<spec/>"

        def launch(self, use_pycuerun: bool) -> None:
            said["launched"] = use_pycuerun
            if said.get("broken"):
                raise ConnectionError("no cuebot")

    modules = {
        "outline": {"Outline": Outline},
        "outline.modules.shell": {"Shell": Shell},
        "outline.cuerun": {"OutlineLauncher": OutlineLauncher},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return said


def test_opencue_gets_a_layer_a_step_and_a_frame_a_task(job: Path, pyoutline) -> None:
    done = submit(SubmitSpec(job=job, farm="opencue", chunk=200, priority=9))
    assert pyoutline["launched"] is False, "workers need no pyoutline"
    assert pyoutline["flags"] == {"priority": 9}
    assert pyoutline["name"] == "__Param_Nope_____touch_pwned_____"
    assert pyoutline["range"] == "1-3", "a layer outside the outline's range is dropped silently"
    layers = pyoutline["layers"]
    assert {name: layer.arguments["range"] for name, layer in layers.items()} == {
        "map": "1-3",
        "join": "1-1",
    }
    assert layers["join"].after == ["map"]
    # The folder's name has blanks: OpenCue hands the words to a shell, so they come quoted.
    spec = done.bundle.absolute() / "tasks/map/#IFRAME#.yaml"
    assert layers["map"].arguments["command"] == [
        *("usdface", "run", f"'{spec}'", "--make-folders", "--progress", "openjd"),
    ]


def test_opencue_that_cannot_be_reached_is_said(job: Path, pyoutline) -> None:
    pyoutline["broken"] = True
    with pytest.raises(CheckFailedError, match="OpenCue: ConnectionError: no cuebot"):
        submit(SubmitSpec(job=job, farm="opencue"))


def test_a_path_that_opencue_would_take_for_a_frame_is_refused(
    job: Path, tmp_path: Path, pyoutline
) -> None:
    with pytest.raises(InputError, match="in a path means a frame to OpenCue"):
        submit(SubmitSpec(job=job, farm="opencue", out=tmp_path / "#IFRAME#"))


def test_without_pyoutline_it_is_said_how_to_get_it(job: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "outline", None)
    with pytest.raises(InputError, match="install it with: pip install"):
        submit(SubmitSpec(job=job, farm="opencue"))


def test_the_real_pyoutline_takes_what_we_build(job: Path, monkeypatch) -> None:
    pytest.importorskip("outline", reason="needs opencue-pyoutline and opencue-pycue")
    pytest.importorskip("opencue", reason="needs opencue-pycue")
    monkeypatch.setenv("SHOW", "demo")
    monkeypatch.setenv("SHOT", "sh010")
    done = submit(SubmitSpec(job=job, farm="opencue", chunk=200, write_only=True))
    from xml.etree import ElementTree

    outline = done.bundle.with_name(f"{done.bundle.name}.outline.xml")
    text = outline.read_text(encoding="utf-8").partition('dtd">')[2]
    layers = ElementTree.fromstring(text).findall("job/layers/layer")
    assert [layer.get("name") for layer in layers] == ["map", "join"]


def test_the_command_says_what_it_wrote(job: Path, capsys) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["submit", str(job), "--chunk", "200", "--write-only", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["figures"]["tasks"] == {"map": 3, "join": 1}
    assert (Path(report["outputs"][0]) / "template.yaml").is_file()


def test_a_job_whose_frames_are_not_known_yet_says_so(job: Path, shot: Shot, capsys) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["submit", str(shot / "shot.job.yaml"), "--write-only"])
    told = capsys.readouterr().out
    assert "shot: 7 tasks, written" in told
    assert "not split into chunks: shot.hero.usda" in told


@pytest.mark.slow
def test_a_worker_needs_only_the_wheel(job: Path, tmp_path: Path) -> None:
    """In an environment with the wheel and what it depends on, without any farm's client."""
    from tests.regenerate import REPOSITORY

    wheels = tmp_path / "wheels"
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
    )
    (wheel,) = wheels.glob("*.whl")
    worker = tmp_path / "worker"
    subprocess.run([sys.executable, "-m", "venv", str(worker)], check=True)
    python = worker / "bin" / "python"
    installed = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", str(wheel)], capture_output=True, text=True
    )
    if installed.returncode:
        pytest.skip(f"the package index cannot be reached: {installed.stderr[-200:]}")
    done = submit(SubmitSpec(job=job, chunk=200, write_only=True))
    task = done.bundle / "tasks" / "map" / "1.yaml"
    command = [python.with_name("usdface"), "run", task, "--make-folders", "--progress", "openjd"]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "openjd_progress: 100.0" in ran.stdout
