"""What is in the wheel is all that a studio's machine needs."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.regenerate import REPOSITORY


@pytest.fixture(scope="module")
def unpacked_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_schemas_travel_in_the_wheel_and_are_registered_from_it(unpacked_wheel: Path) -> None:
    assert (unpacked_wheel / "usdface" / "schemas" / "usdface" / "plugInfo.json").is_file()
    script = (
        "import usdface.usdio; from usdface.core.plugin_path import schema_folder; "
        "print(schema_folder())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PXR_PLUGINPATH_NAME"}
    found = subprocess.run(
        [sys.executable, "-c", script],
        env=environment | {"PYTHONPATH": str(unpacked_wheel)},
        cwd=unpacked_wheel,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(found.stdout.strip()).is_relative_to(unpacked_wheel)


def test_no_test_or_fixture_travels_in_the_wheel(unpacked_wheel: Path) -> None:
    assert {each.name for each in unpacked_wheel.iterdir() if "dist-info" not in each.name} == {
        "usdface"
    }


def test_specs_import_without_numpy_or_usd() -> None:
    script = (
        "import sys; import usdface.specs.job; "
        "print(sorted({'numpy', 'pxr', 'scipy', 'av'} & set(sys.modules)))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_help_does_not_wait_for_usd_or_scipy() -> None:
    script = (
        "import sys; from usdface.cli.app import make_app; make_app(); "
        "print(sorted({'pxr', 'scipy', 'av', 'embreex'} & set(sys.modules)))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_steps_wait_for_figures_and_trackers_until_they_are_needed() -> None:
    steps = "usdface.steps.capture.track, usdface.steps.references.coverage"
    script = (
        f"import sys, usdface.cli.app, usdface.steps.capture.clean, {steps}; "
        "print(sorted({'cv2', 'matplotlib', 'mediapipe'} & set(sys.modules)))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_pages_travel_in_the_wheel(unpacked_wheel: Path) -> None:
    source = REPOSITORY / "pipeline" / "usdface" / "media" / "web"
    shipped = unpacked_wheel / "usdface" / "media" / "web"
    assert {each.name for each in shipped.iterdir()} == {each.name for each in source.iterdir()}
