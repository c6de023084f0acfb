"""What users really hand in: each fault a sentence with file, place, value and remedy; exit code 2.

Nothing on disk may change.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Vt

from tests.c3d_write import write_c3d
from tests.steps.small_shot import Shot
from usdface.cli import main
from usdface.runner.execute import execute
from usdface.specs.capture import IngestSpec
from usdface.specs.edits import EditSpec
from usdface.usdio.take.read import read_take

pytestmark = pytest.mark.usefixtures("without_comparison")

COMMAND = Path(sys.executable).with_name("usdface")


def usdface(*arguments: object, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.is_file()}


def truncated(shot: Shot) -> list[str]:
    data = (shot / "shot.c3d").read_bytes()
    (shot / "bad.c3d").write_bytes(data[: len(data) // 2])
    return ["ingest", "bad.c3d", "--out", "new.take.usda"]


def foreign(shot: Shot) -> list[str]:
    (shot / "bad.c3d").write_bytes(b"GIF89a" + bytes(range(256)) * 20)
    return ["ingest", "bad.c3d", "--out", "new.take.usda"]


def empty(shot: Shot) -> list[str]:
    (shot / "bad.c3d").write_bytes(b"")
    return ["ingest", "bad.c3d", "--out", "new.take.usda"]


def rate_of_zero(shot: Shot) -> list[str]:
    data = bytearray((shot / "shot.c3d").read_bytes())
    data[20:24] = bytes(4)  # in the header, and in every parameter named RATE
    place = data.find(b"RATE", 512)
    while place >= 0:
        value = place + 8 + data[place + 7]  # name, offset, type, dimensions
        data[value : value + 4] = bytes(4)
        place = data.find(b"RATE", value)
    (shot / "bad.c3d").write_bytes(bytes(data))
    return ["ingest", "bad.c3d", "--out", "new.take.usda"]


def unknown_rigid(shot: Shot) -> list[str]:
    return ["ingest", "shot.c3d", "--out", "new.take.usda", "--rigid", "head_1,nose_99"]


def neutral_outside(shot: Shot) -> list[str]:
    return ["ingest", "shot.c3d", "--out", "new.take.usda", "--neutral", "9999"]


def no_rigid_markers(shot: Shot) -> list[str]:
    rng = np.random.default_rng(0)
    cloud = rng.normal(0, 30, (200, 6, 3)) + rng.normal(0, 60, (1, 6, 3))
    write_c3d(shot / "jelly.c3d", cloud, np.ones((200, 6), bool), list("abcdef"), rate=60)
    execute(IngestSpec(sources=(shot / "jelly.c3d",), out=shot / "jelly.take.usda"))
    return ["clean", "jelly.take.usda", "--out", "new.take.usda"]


def clean_twice_named_wrongly(shot: Shot) -> list[str]:
    return ["select", "shot.take.usda", "--rig", "hero.usdc", "--out", "new.references.usda"]


def too_many_pairs(shot: Shot) -> list[str]:
    return [
        *("select", "shot.clean.take.usda", "--rig", "hero.usdc"),
        *("--out", "new.references.usda", "--count", "9999"),
    ]


def rig_without_shapes(shot: Shot) -> list[str]:
    layer = Sdf.Layer.CreateNew(str(shot / "bare.usda"))
    for path, kind in (("/Hero", "SkelRoot"), ("/Hero/skin", "Mesh")):
        prim = Sdf.CreatePrimInLayer(layer, path)
        prim.specifier, prim.typeName = Sdf.SpecifierDef, kind
    layer.Save()
    return [
        *("select", "shot.clean.take.usda", "--rig", "bare.usda"),
        *("--out", "new.references.usda", "--count", "10"),
    ]


def names_that_match_nothing(shot: Shot) -> list[str]:
    (shot / "tuned.csv").write_text("frame,tail_wag,ear_flop\n1,0.5,0.5\n")
    return ["references", "import", "hero.references.usda", "--weights", "tuned.csv"]


def frames_that_match_nothing(shot: Shot) -> list[str]:
    (shot / "tuned.csv").write_text("frame,jawOpen\n90001,0.5\n")
    return ["references", "import", "hero.references.usda", "--weights", "tuned.csv"]


def nan_in_the_table(shot: Shot) -> list[str]:
    (shot / "tuned.csv").write_text("frame,jawOpen\n1,0.5\n2,nan\n")
    return ["references", "import", "hero.references.usda", "--weights", "tuned.csv"]


def too_many_dimensions(shot: Shot) -> list[str]:
    return ["train", "hero.references.usda", "--out", "new.mapping.usdc", "--dimensions", "40"]


def unknown_method(shot: Shot) -> list[str]:
    return ["train", "hero.references.usda", "--out", "new.mapping.usdc", "--method", "magic"]


def nan_in_the_take(shot: Shot) -> list[str]:
    layer = Sdf.Layer.FindOrOpen(str(shot / "shot.clean.take.samples.usdc"))
    points = np.array(layer.QueryTimeSample("/Take/Markers.points", 7))
    points[3] = np.nan
    layer.SetTimeSample("/Take/Markers.points", 7, Vt.Vec3fArray.FromNumpy(points))
    layer.Save()
    return map_arguments()


def map_arguments(**changed: str) -> list[str]:
    given = {"mapping": "hero.mapping.usdc", "rig": "hero.usdc", "out": "new.hero.usda"} | changed
    options = [part for name, value in given.items() for part in (f"--{name}", value)]
    return ["map", "shot.clean.take.usda", *options]


def another_rig(shot: Shot) -> list[str]:
    text = (shot / "hero.usdc").read_bytes()
    (shot / "other.usdc").write_bytes(text)
    layer = Sdf.Layer.FindOrOpen(str(shot / "other.usdc"))
    rename_all_shapes(layer)
    layer.Save()
    return map_arguments(rig="other.usdc")


def rename_all_shapes(layer: Sdf.Layer) -> None:
    def visit(path: Sdf.Path) -> None:
        if path.name == "skel:blendShapes":
            spec = layer.GetAttributeAtPath(path)
            spec.default = [f"bs_{name}" for name in spec.default]

    layer.Traverse(layer.pseudoRoot.path, visit)


def mapping_that_is_none(shot: Shot) -> list[str]:
    return map_arguments(mapping="hero.usdc")


def frames_outside(shot: Shot) -> list[str]:
    return map_arguments(frames="400-900")


def frames_backwards(shot: Shot) -> list[str]:
    return map_arguments(frames="90-40")


def missing_folder(shot: Shot) -> list[str]:
    return map_arguments(out="no/such/folder/new.usda")


def wrong_extension(shot: Shot) -> list[str]:
    return map_arguments(out="new.hero.txt")


def newer_output(shot: Shot) -> list[str]:
    return ["clean", "shot.take.usda", "--max-gap", "7", "--out", "shot.clean.take.usda"]


def output_of_someone_else(shot: Shot) -> list[str]:
    (shot / "mine.usda").write_text("#usda 1.0\n")
    return ["clean", "shot.take.usda", "--out", "mine.usda"]


def output_that_is_the_input(shot: Shot) -> list[str]:
    (shot / "beside").mkdir()
    return ["clean", "shot.take.usda", "--out", "beside/../shot.take.usda", "--overwrite"]


def output_that_is_beneath_the_input(shot: Shot) -> list[str]:
    execute(EditSpec(performance=shot / "shot.hero.usda", shape=("jawOpen",), add=0.1))
    return ["bake", "shot.hero.usda", "--out", "shot.hero.edits.usda", "--overwrite"]


def samples_of_the_input(shot: Shot) -> list[str]:
    return ["clean", "shot.take.usda", "--out", "shot.take.samples.usdc"]


def output_of_another_kind(shot: Shot) -> list[str]:
    newest = (shot / "shot.hero.usda").stat().st_mtime + 60.0
    os.utime(shot / "shot.hero.usda", (newest, newest))
    return ["bake", "shot.hero.usda", "--out", "hero.references.tuned.usda"]


def sheet_of_another_take(shot: Shot) -> list[str]:
    return [
        *("sheet", "shot.hero.usda", "--take", "shot.clean.take.usda"),
        *("--out", "new.jpg", "--frames", "700-800"),
    ]


def unknown_picture_format(shot: Shot) -> list[str]:
    return ["sheet", "shot.hero.usda", "--take", "shot.clean.take.usda", "--out", "new.gif"]


CASES: list[tuple[Callable[[Shot], list[str]], tuple[str, ...]]] = [
    (truncated, ("bad.c3d",)),
    (foreign, ("bad.c3d", "format")),
    (empty, ("bad.c3d",)),
    (rate_of_zero, ("bad.c3d", "rate", "0")),
    (unknown_rigid, ("shot.c3d", "nose_99")),
    (neutral_outside, ("shot.c3d", "9999", "--neutral")),
    (no_rigid_markers, ("jelly.take.usda", "rigid")),
    (clean_twice_named_wrongly, ("shot.take.usda", "usdface clean")),
    (too_many_pairs, ("9999", "480", "--count")),
    (rig_without_shapes, ("bare.usda", "BlendShapes")),
    (names_that_match_nothing, ("tuned.csv", "tail_wag", "rename")),
    (frames_that_match_nothing, ("tuned.csv", "90001", "--at")),
    (nan_in_the_table, ("tuned.csv", "line 3", "jawOpen", "nan")),
    (too_many_dimensions, ("40", "24")),
    (unknown_method, ("magic", "d06")),
    (nan_in_the_take, ("time code 7", "brow_L4", "not finite")),
    (another_rig, ("other.usdc", "bs_", "train again for this rig")),
    (mapping_that_is_none, ("hero.usdc", "usdface train")),
    (frames_outside, ("400-900", "1-480")),
    (frames_backwards, ("frames", "40", "precedes")),
    (missing_folder, ("no/such/folder", "does not exist")),
    (wrong_extension, ("new.hero.txt", ".usda")),
    (newer_output, ("shot.clean.take.usda", "newer", "--overwrite")),
    (output_of_someone_else, ("mine.usda", "not written by usdface", "--overwrite")),
    (output_that_is_the_input, ("shot.take.usda", "is an input of clean", "--out")),
    (output_that_is_beneath_the_input, ("shot.hero.edits.usda: is a layer of shot.hero", "bake")),
    (samples_of_the_input, ("shot.take.samples.usdc: is a layer of shot.take.usda", "clean")),
    (output_of_another_kind, ("hero.references.tuned.usda: exists", "`references-import`")),
    (sheet_of_another_take, ("700-800",)),
    (unknown_picture_format, ("new.gif", ".jpg")),
]


@pytest.mark.parametrize(
    ("spoil", "words"), CASES, ids=lambda value: getattr(value, "__name__", None)
)
def test_bad_input_is_refused_and_nothing_is_lost(
    shot: Shot, spoil, words, monkeypatch, capsys
) -> None:
    arguments = spoil(shot)
    before = contents(shot.folder)
    monkeypatch.chdir(shot.folder)
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    told = capsys.readouterr().err
    assert stopped.value.code == 2, told
    assert "internal error" not in told
    for word in words:
        assert word in told
    assert contents(shot.folder) == before


def test_the_installed_command_refuses_without_a_traceback(shot: Shot) -> None:
    done = usdface(*truncated(shot), folder=shot.folder)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("usdface: bad.c3d")  # progress, if slow, before
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(shot: Shot) -> None:
    locked = shot / "locked"
    locked.mkdir(mode=0o500)
    done = usdface(*map_arguments(out="locked/new.usda"), folder=shot.folder)
    assert done.returncode == 2
    assert "cannot be written; check its permissions" in done.stderr


def test_an_interrupted_command_leaves_no_half_file(shot: Shot) -> None:
    before = contents(shot.folder)
    command = [COMMAND, "clean", "shot.take.usda", "--out", "new.take.usda"]
    process = subprocess.Popen(command, cwd=shot.folder)
    time.sleep(0.5)
    process.terminate()
    code = process.wait(timeout=30)
    assert code in (0, 3, -15)  # before our handler is set, the default
    after = contents(shot.folder)
    written = after.keys() - before.keys()
    assert {name: after[name] for name in before} == before
    if code == 0 or written:  # on a fast machine, the signal may come too late
        assert written == {"new.take.usda", "new.take.samples.usdc"}
        assert read_take(shot / "new.take.usda").frame_count > 0
