"""A binary layer that does not hold together is refused before USD opens it."""

import os
import struct
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from pxr import Sdf, UsdUtils

from tests.faults.crate_file import sections, table_start
from usdface.core.errors import InputError
from usdface.usdio.crate import PARTS, check_crate
from usdface.usdio.layers import open_layer, open_stage
from usdface.usdio.referenced_files import all_files, dependencies, referenced_files


@pytest.fixture
def crate(tmp_path: Path) -> Path:
    """Write a layer of two prims, one in a variant, with a value each."""
    path = tmp_path / "face.usdc"
    layer = Sdf.Layer.CreateNew(str(path))
    for place in ("/face", "/face/brow"):
        prim = Sdf.CreatePrimInLayer(layer, place)
        prim.specifier = Sdf.SpecifierDef
        Sdf.AttributeSpec(prim, "size", Sdf.ValueTypeNames.FloatArray).default = [1.0] * 40
    sets = Sdf.VariantSetSpec(layer.GetPrimAtPath("/face"), "look")
    Sdf.CreatePrimInLayer(layer, Sdf.VariantSpec(sets, "old").path.AppendChild("wrinkle"))
    layer.defaultPrim = "face"
    layer.Save()
    return path


def put(path: Path, at: int, number: int) -> None:
    content = bytearray(path.read_bytes())
    struct.pack_into("<q", content, at, number)
    path.write_bytes(content)


def test_a_sound_layer_passes_under_any_name_and_so_does_what_is_none(crate: Path) -> None:
    check_crate(crate)
    check_crate(crate.rename(crate.with_suffix(".usd")))
    open_stage(crate.with_suffix(".usd"))
    crate.write_text("#usda 1.0\n")
    check_crate(crate)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_that_says_it_holds_more_than_it_can_is_refused(crate: Path, name: str) -> None:
    (part,) = (each for each in sections(crate.read_bytes()) if each.name == name)
    put(crate, part.start, 2**31)
    with pytest.raises(InputError, match=rf"face\.usdc: .*{name} of \d+ bytes .* hold 2147483648"):
        open_layer(crate)


@pytest.mark.parametrize("number", [-1, 0, 2**40, 2**63 - 1, -(2**63)])
@pytest.mark.parametrize("name", PARTS)
def test_a_part_that_lies_outside_the_file_or_over_another_is_refused(
    crate: Path, name: str, number: int
) -> None:
    content = crate.read_bytes()
    (part,) = (each for each in sections(content) if each.name == name)
    for field in (16, 24):
        crate.write_bytes(content)
        put(crate, part.entry + field, number)
        with pytest.raises(InputError, match=r"face\.usdc: a damaged binary layer"):
            check_crate(crate)


def test_more_specs_than_paths_are_refused(crate: Path) -> None:
    found = {part.name: part for part in sections(crate.read_bytes())}
    (paths,) = struct.unpack_from("<Q", crate.read_bytes(), found["PATHS"].start)
    put(crate, found["SPECS"].start, paths + 1)
    with pytest.raises(InputError, match=rf"{paths + 1} specs at {paths} paths"):
        check_crate(crate)


def test_a_table_that_is_elsewhere_or_lacks_a_part_is_refused(crate: Path) -> None:
    content = crate.read_bytes()
    for at, number in ((16, 2**62), (16, 0), (table_start(content), 5), (table_start(content), -1)):
        crate.write_bytes(content)
        put(crate, at, number)
        with pytest.raises(InputError, match="a damaged binary layer"):
            check_crate(crate)


def test_a_layer_cut_anywhere_is_refused(crate: Path) -> None:
    content = crate.read_bytes()
    for size in range(8, len(content), 7):
        crate.write_bytes(content[:size])
        with pytest.raises(InputError, match="a damaged binary layer"):
            check_crate(crate)


def test_a_layer_below_is_looked_at_before_usd_opens_it(crate: Path, tmp_path: Path) -> None:
    middle, top = tmp_path / "middle.usda", tmp_path / "top.usda"
    layer = Sdf.Layer.CreateNew(str(middle))
    prim = Sdf.CreatePrimInLayer(layer, "/there")
    prim.referenceList.prependedItems = [Sdf.Reference("./face.usdc")]
    layer.Save()
    layer = Sdf.Layer.CreateNew(str(top))
    layer.subLayerPaths = ["./middle.usda"]
    layer.Save()
    assert open_stage(top).GetPrimAtPath("/there/brow")
    del layer, prim
    specs = sections(crate.read_bytes())[-1]
    put(crate, specs.start, 2**40)
    for read in (open_stage, dependencies, all_files, referenced_files):
        with pytest.raises(InputError, match=r"face\.usdc: a damaged binary layer: part SPECS"):
            read(top)


@pytest.mark.parametrize("name", ["a" * 5000, "a/" * 3000, "é\\n", "gone"])
def test_a_name_that_no_file_has_is_no_matter(tmp_path: Path, name: str) -> None:
    layer = Sdf.Layer.CreateNew(str(tmp_path / "face.usda"))
    prim = Sdf.CreatePrimInLayer(layer, "/face")
    prim.referenceList.prependedItems = [Sdf.Reference(f"./{name}.usdc", "/face")]
    layer.Save()
    assert open_stage(tmp_path / "face.usda").GetPrimAtPath("/face")


def test_text_that_is_none_in_a_variant_that_is_not_chosen_is_no_matter(tmp_path: Path) -> None:
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef def")
    layer = Sdf.Layer.CreateNew(str(tmp_path / "face.usda"))
    sets = Sdf.VariantSetSpec(Sdf.CreatePrimInLayer(layer, "/face"), "look")
    prim = Sdf.VariantSpec(sets, "old").primSpec
    prim.referenceList.prependedItems = [Sdf.Reference("./broken.usda", "/face")]
    layer.Save()
    assert open_stage(tmp_path / "face.usda").GetPrimAtPath("/face")


def test_a_layer_within_a_package_is_looked_at(crate: Path, tmp_path: Path) -> None:
    package = tmp_path / "face.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(crate), str(package))
    check_crate(package)
    with zipfile.ZipFile(package) as found:
        (inner,) = found.infolist()
    start = package.read_bytes().index(b"PXR-USDC")
    put(package, start + sections(crate.read_bytes())[-1].start, 2**40)
    with pytest.raises(InputError, match=rf"face\.usdz\[{inner.filename}\]: a damaged binary"):
        open_stage(package)


def test_a_prim_that_is_listed_and_not_there_is_refused_where_usd_would_end(tmp_path: Path) -> None:
    path = tmp_path / "two.usdc"
    layer = Sdf.Layer.CreateNew(str(path))
    Sdf.CreatePrimInLayer(layer, "/face/brow")
    layer.Save()
    del layer
    os.utime(path, (1, 1))  # the next writing changes it, however coarse the system's clock is
    open_stage(path)  # a sound file is not checked again until it is changed
    content = path.read_bytes()
    end = min(each.start for each in sections(content))
    # A list of children: how many, and by number which names.
    lists = [at for at in range(88, end - 11) if content[at : at + 8] == struct.pack("<Q", 1)]
    told = []
    for at in lists:
        path.write_bytes(content[: at + 8] + struct.pack("<I", 10_000) + content[at + 12 :])
        with pytest.raises(InputError, match=r"two\.usdc: ") as refused:
            open_stage(path)
        told.append(str(refused.value))
    # USD itself looks at the children of prims, and not at the prims at the top.
    assert any("is listed and not there" in each for each in told)


@pytest.mark.parametrize("version", ["0.4.0", "0.7.0", "0.10.0"])
def test_every_version_that_usd_reads_passes(crate: Path, version: str) -> None:
    written = crate.with_name("written.usdc")
    code = (
        "import sys\nfrom pxr import Sdf\n"
        "assert Sdf.Layer.OpenAsAnonymous(sys.argv[1]).Export(sys.argv[2])"
    )
    environment = os.environ | {"USD_WRITE_NEW_USDC_FILES_AS_VERSION": version}
    subprocess.run(
        [sys.executable, "-c", code, str(crate), str(written)],
        check=True,
        env=environment,
        capture_output=True,
    )
    assert ".".join(map(str, written.read_bytes()[8:11])) == version
    check_crate(written)


def test_looking_costs_less_than_a_millisecond(crate: Path) -> None:
    def once() -> float:
        start = time.perf_counter()
        check_crate(crate)
        return time.perf_counter() - start

    assert min(once() for _ in range(20)) < 1e-3
