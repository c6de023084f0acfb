"""What lies in hooks/ beside plug-ins: the farm's environment, rez's package, Blender's check."""

import json
import runpy
import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

from tests.hooks.loading import HOOKS, load
from usdface.core.plugin_path import PACKAGE
from usdface.core.version import __version__

ENVIRONMENT = HOOKS / "farm" / "usdface_environment.yaml"


def test_the_farms_environment_is_one() -> None:
    model = pytest.importorskip("openjd.model", reason="needs the farm extra: openjd-model")
    template = yaml.safe_load(ENVIRONMENT.read_text())
    found = model.decode_environment_template(template=template)
    assert found.environment.name == "usdface"


class Variable:
    """As much of rez's environment variables as a package sets."""

    def __init__(self) -> None:
        self.values: list[str] = []

    def append(self, value: str) -> None:
        self.values.append(value)


@pytest.fixture
def rez(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The package as rez reads it: with its own words for scopes and what is found early."""
    settings = SimpleNamespace()
    newest = {"python": "3.11.7", "platform": "linux"}  # no package of the arch, in this studio

    def get_latest_package(name: str, range_: str | None = None) -> object:
        if name not in newest:
            return None
        trimmed = ".".join(newest[name].split(".")[:2])
        return SimpleNamespace(version=SimpleNamespace(trim=lambda tokens: trimmed))

    system = SimpleNamespace(platform="linux", arch="x86_64")
    for name, values in (
        ("rez", {}),
        ("rez.packages", {"get_latest_package": get_latest_package}),
        ("rez.system", {"system": system}),
    ):
        module = ModuleType(name)
        module.__dict__.update(values)
        monkeypatch.setitem(sys.modules, name, module)
    words = {"scope": lambda name: nullcontext(settings), "early": lambda: lambda found: found}
    return runpy.run_path(str(HOOKS / "rez" / "package.py"), init_globals=words)


def test_rezs_package_says_the_version_and_where_everything_is(rez: dict[str, object]) -> None:
    assert rez["version"] == __version__
    names = ("PYTHONPATH", "PATH", "PYBLISHPLUGINPATH", "PXR_PLUGINPATH_NAME")
    env = SimpleNamespace(**{name: Variable() for name in names})
    rez["commands"].__globals__["env"] = env
    rez["commands"]()
    (hooks,) = env.PYBLISHPLUGINPATH.values
    schemas, checks = env.PXR_PLUGINPATH_NAME.values
    inside = "{root}/python/usdface/"
    assert (HOOKS.parent / hooks.removeprefix(inside)).is_dir()
    assert (HOOKS.parent / schemas.removeprefix(inside) / "plugInfo.json").is_file()
    assert (PACKAGE / checks.removeprefix(inside) / "plugInfo.json").is_file()


def test_rezs_package_is_for_the_python_that_its_compiled_parts_are_for(rez) -> None:
    assert rez["variants"]() == [["platform-linux", "python-3.11"]]


def test_rez_builds_outside_of_what_goes_into_the_wheel(rez) -> None:
    assert rez["config"].build_directory == "../../build/rez"


def test_rez_installs_over_what_was_there_and_only_when_told_to(tmp_path, monkeypatch) -> None:
    build = load("rez/build.py")
    ran = []
    monkeypatch.setattr(
        build.subprocess,
        "run",
        lambda command, check: ran.append(command) or SimpleNamespace(returncode=3),
    )
    old = tmp_path / "python" / "usdface" / "old.py"
    old.parent.mkdir(parents=True)
    old.touch()
    monkeypatch.setenv("REZ_BUILD_SOURCE_PATH", str(HOOKS / "rez"))
    monkeypatch.setenv("REZ_BUILD_INSTALL_PATH", str(tmp_path))
    monkeypatch.setenv("REZ_BUILD_INSTALL", "0")
    assert build.main() == 0
    assert old.exists()
    assert not ran
    monkeypatch.setenv("REZ_BUILD_INSTALL", "1")
    assert build.main() == 3
    assert not old.exists()
    assert ran[0][-2:] == [str(tmp_path / "python"), str(HOOKS.parent)]


class Key:
    """A shape key that follows the scene's frame."""

    def __init__(self, name: str, scene: SimpleNamespace, speed: float) -> None:
        self.name, self._scene, self._speed = name, scene, speed

    @property
    def value(self) -> float:
        return self._speed * (self._scene.now - 1)


def blender(*speeds: float, result: object = frozenset({"FINISHED"})) -> SimpleNamespace:
    """As much of bpy as the check asks for."""
    render = SimpleNamespace(fps=30, fps_base=1.001)
    scene = SimpleNamespace(frame_start=1, frame_end=100, render=render, now=1)
    scene.frame_set = lambda frame: setattr(scene, "now", frame)
    keys = [Key(f"s{number}", scene, speed) for number, speed in enumerate((0.0, *speeds))]
    mesh = SimpleNamespace(name="face", shape_keys=SimpleNamespace(key_blocks=keys))
    plain = SimpleNamespace(name="teeth", shape_keys=None)

    def usd_import(filepath: str, set_frame_range: bool) -> object:
        if isinstance(result, Exception):
            raise result
        return result

    wm = SimpleNamespace(read_factory_settings=lambda use_empty: None, usd_import=usd_import)
    return SimpleNamespace(
        context=SimpleNamespace(scene=scene),
        data=SimpleNamespace(meshes=[mesh, plain]),
        ops=SimpleNamespace(wm=wm),
    )


def test_blenders_check_tells_moving_shapes_from_still_ones(capsys) -> None:
    check = load("blender/check_performance.py")
    assert check.check(blender(0.01, 0.0), "x.usda") == 0
    told = capsys.readouterr().out
    assert "face.s1: moves by 0.990" in told
    assert "1 shapes are animated" in told
    assert "its own rate, 29.97 frames per second" in told
    assert check.check(blender(0.0), "x.usda") == 1
    assert check.check(blender(0.01, result=RuntimeError("no file")), "x.usda") == 2
    assert check.check(blender(0.01, result={"CANCELLED"}), "x.usda") == 2


def test_blenders_check_says_what_to_give_where_there_is_no_mesh(capsys) -> None:
    without = blender(0.01)
    without.data.meshes.clear()
    check = load("blender/check_performance.py")
    assert check.check(without, "shot.published.usdc") == 1
    assert "opens without a mesh" in capsys.readouterr().err


def test_every_hook_reads_as_python() -> None:
    for path in HOOKS.rglob("*.py"):
        compile(path.read_text(encoding="utf-8"), str(path), "exec")


def test_hooks_name_no_path_of_this_machine() -> None:
    for path in (each for each in HOOKS.rglob("*") if each.is_file() and each.suffix != ".pyc"):
        text = path.read_text(encoding="utf-8")
        assert "/home/" not in text, path
        assert str(HOOKS.parent) not in text, path


@pytest.mark.slow
def test_a_session_without_usdface_fails_at_once(tmp_path: Path) -> None:
    openjd = Path(sys.executable).with_name("openjd")
    if not openjd.exists():
        pytest.skip("needs the farm extra: openjd-cli")
    template = tmp_path / "template.json"
    step = {"name": "s", "script": {"actions": {"onRun": {"command": "true"}}}}
    template.write_text(
        json.dumps({"specificationVersion": "jobtemplate-2023-09", "name": "j", "steps": [step]})
    )
    command = [openjd, "run", template, "--environment", ENVIRONMENT]
    for path, code in ((str(Path(sys.executable).parent), 0), ("", 1)):
        found = f"{path}:{Path(shutil.which('true') or '/bin/true').parent}".strip(":")
        ran = subprocess.run(command, env={"PATH": found}, capture_output=True, text=True)
        assert ran.returncode == code, ran.stdout
