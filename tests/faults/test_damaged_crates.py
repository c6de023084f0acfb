"""Every reader of USD against binary layers and packages that are damaged as files.

They are read in a process of their own, bounded in memory and time, as USD reads binary layers in
C++, which may end it. That it seldom does is held here; that nothing but our own error leaves
usdface, and that nothing hangs, is held without exception.
"""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pxr import UsdUtils

from tests.faults.crate_damage import CRATE_DAMAGES, PACKAGE_DAMAGES, Damage
from tests.faults.crate_file import sections
from tests.faults.crate_survey import PACKAGES, Subject, Tally, lay_out, survey
from tests.faults.layer_reader import LayerReader
from tests.faults.world import World
from tests.small_scan import small_scan, small_scan_take, write_scan
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.write import write_take

MOST_ENDED = 0.005
"""Of damaged files, those that may end the process in USD; one in some thousands was measured."""
EACH, EACH_QUICK = 40, 12

SMALL = (
    Subject("take", "talk.take.usda", "talk.take.samples.usdc"),
    Subject("rig", "hero.usdc", "hero.usdc"),
    Subject("mesh", "scan.usdc", "scan.usdc"),
    Subject("validate", "hero.usdc", "hero.usdc"),
    Subject("files", "talk.take.usda", "talk.take.samples.usdc"),
)
SMALL_PACKAGES = (
    Subject("rig", "hero.usdz", "hero.usdz"),
    Subject("validate", "hero.usdz", "hero.usdz"),
)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LayerReader]:
    with LayerReader(tmp_path_factory.mktemp("scratch")) as process:
        yield process


@pytest.fixture(scope="module")
def finished(
    world: World, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, tuple[Subject, ...]]:
    folder = tmp_path_factory.mktemp("crates") / "damaged"
    return folder, lay_out(world.folder, folder)


def check(found: dict[str, Tally]) -> None:
    told = "\n".join(each for tally in found.values() for each in tally.told)
    for tally in found.values():
        assert set(tally.ends) <= {"read", "refused", "ended"}, told
    ended = sum(tally.ends["ended"] for tally in found.values())
    assert ended <= max(1, MOST_ENDED * sum(tally.ends.total() for tally in found.values())), told


@pytest.mark.slow
def test_some_hundred_damaged_layers_and_packages_are_read_or_refused(
    reader: LayerReader, tmp_path: Path
) -> None:
    scan = small_scan()
    write_scan(tmp_path / "scan.usdc", scan)
    write_take(tmp_path / "talk.take.usda", small_scan_take(scan), provenance=Provenance())
    write_rig(tmp_path / "hero.usdc", small_rig())
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "hero.usdc"), str(tmp_path / "hero.usdz"))
    found = survey(reader, tmp_path, SMALL, CRATE_DAMAGES, each=EACH_QUICK)
    packages = survey(reader, tmp_path, SMALL_PACKAGES, PACKAGE_DAMAGES, each=EACH_QUICK)
    check(found)
    check(packages)
    for tallies in (found, packages):
        refused = sum(tally.ends["refused"] for tally in tallies.values())
        assert refused > 0.2 * sum(tally.ends.total() for tally in tallies.values())


def test_the_command_says_so_and_ends_with_2(tmp_path: Path) -> None:
    path = tmp_path / "hero.usdc"
    write_rig(path, small_rig())
    content = bytearray(path.read_bytes())
    specs = next(each for each in sections(bytes(content)) if each.name == "SPECS")
    content[specs.start + 4] = 1  # four thousand million more
    path.write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-m", "usdface", "validate", str(path)], capture_output=True, text=True
    )
    assert done.returncode == InputError.exit_code
    assert "hero.usdc: a damaged binary layer: part SPECS" in done.stderr
    assert "a fault in usdface" not in done.stderr


def test_what_ends_the_process_is_seen(reader: LayerReader, tmp_path: Path) -> None:
    assert reader.ask("end", tmp_path) == "ended: the process ended with 3"
    write_rig(tmp_path / "hero.usdc", small_rig())
    assert reader.ask("rig", tmp_path / "hero.usdc") == "read"


@pytest.mark.faults
@pytest.mark.parametrize("damage", CRATE_DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.xdist_group("crates")
def test_a_damaged_binary_layer_is_read_or_refused(
    reader: LayerReader, finished: tuple[Path, tuple[Subject, ...]], damage: Damage
) -> None:
    folder, subjects = finished
    check(survey(reader, folder, subjects, (damage,), each=EACH))


@pytest.mark.faults
@pytest.mark.xdist_group("crates")
def test_a_damaged_package_is_read_or_refused(
    reader: LayerReader, finished: tuple[Path, tuple[Subject, ...]]
) -> None:
    check(survey(reader, finished[0], PACKAGES, PACKAGE_DAMAGES, each=EACH))
