"""Ways out of the folder that work is confined to, each tried on a finished shot.

What is opened is watched by an audit hook and by inotify: nothing outside the folder is. With the
guard of a way switched off something is, so each guard is needed, and the watch would see it gone.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import usdface
from tests.steps.small_shot import Shot
from tests.watching import opened_by_python, touched_by_anything
from usdface.cli import main
from usdface.core.assets import Video
from usdface.core.confinement import ROOT_VARIABLE
from usdface.core.errors import InputError
from usdface.core.progress import silent
from usdface.core.provenance import Provenance
from usdface.core.side_files import make_side_folder
from usdface.core.sidecars import work_folder
from usdface.media.film.movie import write_movie
from usdface.media.film.video import open_video
from usdface.media.picture.image import write_image
from usdface.model.placement.plausibility import judge_markers
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.placement import placement_of_performance
from usdface.steps.references import images
from usdface.tuning.pictures import PairPictures
from usdface.tuning.session import TuningSession
from usdface.usdio.layers import open_stage
from usdface.usdio.references.read import PairNotes, read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="inotify sees native code")

RED: np.ndarray = np.full((32, 32, 3), (200, 0, 0), np.uint8)


@dataclass(frozen=True)
class Way:
    """How somebody may try to lead a run out of the folder."""

    prepare: Callable[[Shot, Path], None]
    """What they put into it."""
    attempt: Callable[[Shot, Path], object]
    """What is then run: it ends with an error, or without what lies outside."""
    guards: tuple[str, ...]
    """What stops it, as `module.name`; switched off together."""
    confined: bool = True
    """False where it led out whether or not work was confined to a folder."""


def words(line: str) -> Callable[[Shot, Path], object]:
    return lambda shot, outside: main(line.format(outside=outside).split())


def link(name: str, target: str) -> Callable[[Shot, Path], None]:
    return lambda shot, outside: (shot / name).symlink_to(outside / target)


def change(path: Path, *changes: tuple[str, str]) -> None:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


def link_stretches(shot: Shot, outside: Path) -> None:
    work_folder(shot / "m.mp4", "stretches").symlink_to(outside)


def make_stretches(shot: Shot, outside: Path) -> None:
    folder = work_folder(shot / "m.mp4", "stretches")
    make_side_folder(folder)
    write_movie(folder / "1.mp4", [RED], rate=Fraction(1))


def link_sequence(shot: Shot, outside: Path) -> None:
    write_image(shot / "a.0001.png", RED // 2)
    (shot / "a.0002.png").symlink_to(outside / "secret.png")


def see_sequence(shot: Shot, outside: Path) -> None:
    with open_video(shot / "a.0001.png", Fraction(1)) as video:
        video.frame_at(1.5)


def name_video(shot: Shot, outside: Path) -> None:
    video = f"    asset face:video:file = @{outside}/secret.mp4@\n    uniform string face:take ="
    change(shot / "shot.clean.take.usda", ("    uniform string face:take =", video))


def tune_pictures(shot: Shot, outside: Path) -> None:
    references = read_references(shot / "hero.references.usda")
    notes = [PairNotes()] * len(references.frames)
    PairPictures(references, notes, [shot / "shot.clean.take.usda"]).jpeg(0)


def name_in_provenance(shot: Shot, outside: Path) -> None:
    edit = ["edit", "shot.hero.usda", "--shape", "jawOpen", "--add", "0.4", "--frames", "60-90"]
    with pytest.raises(SystemExit, match="0"):
        main(edit)
    change(
        shot / "shot.hero.usda",
        ('"take":"shot.clean', f'"take":"{outside}/shot.clean'),
        ('"mapping":"hero', f'"mapping":"{outside}/hero'),
    )


def vary_expression(shot: Shot, outside: Path) -> None:
    (shot / "inner.usda").write_text("#usda 1.0\n")
    top = '#usda 1.0\n(\n    expressionVariables = {{\n        string X = "{}"\n    }}\n)\n{}'
    sub = 'def "Take" (\n    references = @`"${X}"`@</Take>\n)\n{\n}\n'
    over = 'def "Take" (\n    references = @sub.usda@</Take>\n)\n{\n}\n'
    (shot / "sub.usda").write_text(top.format("./inner.usda", sub))
    (shot / "sly.take.usda").write_text(top.format(f"{outside}/shot.take.usda", over))


def link_clip(shot: Shot, outside: Path) -> None:
    (shot / "clip.001.usda").symlink_to(outside / "shot.take.usda")
    (shot / "sly.take.usda").write_text(
        '#usda 1.0\ndef "Take" (\n    clips = {\n        dictionary default = {\n'
        '            string templateAssetPath = "./clip.###.usda"\n'
        "            double templateStartTime = 1\n            double templateEndTime = 2\n"
        '            double templateStride = 1\n            string primPath = "/Take"\n'
        "        }\n    }\n)\n{\n    double x\n}\n"
    )


def read_clip(shot: Shot, outside: Path) -> None:
    stage = open_stage(shot / "sly.take.usda")
    stage.GetPrimAtPath("/Take").GetAttribute("x").Get(1)


def link_images(shot: Shot, outside: Path) -> None:
    (shot / "hero.references.images").symlink_to(outside)
    write_movie(shot / "v.mp4", [RED] * 9, rate=Fraction(1))


def write_images(shot: Shot, outside: Path) -> None:
    path = shot / "hero.references.usda"
    take = TakeReader(shot / "shot.clean.take.usda").read(1, 1)
    seen = replace(take, video=Video(shot / "v.mp4"))
    spec = SelectSpec(takes=(shot / "shot.clean.take.usda",), rig=shot / "hero.usdc", out=path)
    images.store_images(spec, read_references(path), (seen,), Provenance(), silent)


SAVE_SPEC = "clean shot.take.usda --out n.take.usda --save-spec {outside}/notes.yaml"
FROM_EDITS = (
    "references from-edits shot.hero.usda --references hero.references.usda --out n.references.usda"
)

WAYS = {
    "the lock of an output is a link": Way(
        link(".n.take.usda.lock", "precious.txt"),
        words("ingest shot.c3d --out n.take.usda"),
        ("core.side_files._NO_LINK",),
        confined=False,
    ),
    "the folder of a movie's stretches is a link": Way(
        link_stretches,
        make_stretches,
        ("core.side_files.check_side_folder",),
        confined=False,
    ),
    "the journal of tuning is a link": Way(
        link("hero.references.tuned.journal", "precious.txt"),
        lambda shot, outside: TuningSession(shot / "hero.references.usda").close(),
        ("core.side_files._NO_LINK",),
        confined=False,
    ),
    "the saved spec lies outside": Way(
        lambda shot, outside: None,
        words(SAVE_SPEC),
        ("core.side_files.check_may_open", "core.side_files.confinement_root"),
    ),
    "a later picture of a sequence is a link": Way(
        link_sequence, see_sequence, ("media.picture.image.check_may_open",)
    ),
    "a take that tuning finds by provenance names a video outside": Way(
        name_video,
        tune_pictures,
        ("usdio.reached._check_confined", "media.film.containers.check_may_open"),
    ),
    "provenance names a take and a mapping outside": Way(
        name_in_provenance, words(FROM_EDITS), ("usdio.layers.check_may_open",)
    ),
    "pictures follow provenance to a mapping outside": Way(
        name_in_provenance,
        lambda shot, outside: placement_of_performance(
            shot / "shot.hero.usda", read_rig(shot / "hero.usdc")
        ),
        ("usdio.layers.check_may_open",),
    ),
    "an expression is evaluated by the root layer's variables": Way(
        vary_expression,
        words("clean sly.take.usda --out n.take.usda"),
        ("usdio.reached._check_confined",),
    ),
    "a clip of a pattern is a link": Way(link_clip, read_clip, ("usdio.reached._check_confined",)),
    "the folder of pictures is a link": Way(
        link_images,
        write_images,
        ("steps.references.images.check_side_folder", "core.side_files.check_side_folder"),
        confined=False,
    ),
}


@pytest.fixture
def outside(tmp_path: Path, finished_shot: Shot) -> Path:
    """A folder of somebody else, with what is worth reading or destroying."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "precious.txt").touch()
    write_image(folder / "secret.png", RED)
    write_movie(folder / "secret.mp4", [RED] * 9, rate=Fraction(1))
    for name in ("shot.take.usda", "shot.clean.take.usda", "hero.mapping.usdc"):
        (folder / name).write_bytes((finished_shot / name).read_bytes())
    return folder


def walk(way: Way, shot: Shot, outside: Path) -> list[str]:
    """Try a way; return what was touched outside."""
    with opened_by_python() as opened, touched_by_anything(outside) as touched:
        try:
            way.attempt(shot, outside)
        except (InputError, SystemExit):
            pass
    named = [str(path) for path in opened if path.is_relative_to(outside)]
    return [*touched, *named]


@pytest.mark.parametrize("name", WAYS)
def test_a_way_out_is_closed_and_open_without_its_guard(
    name: str, shot: Shot, outside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    way = WAYS[name]
    monkeypatch.chdir(shot.folder)
    way.prepare(shot, outside)
    monkeypatch.setenv(ROOT_VARIABLE, str(shot.folder) if way.confined else "")
    assert walk(way, shot, outside) == []
    for guard in way.guards:
        off = 0 if guard.endswith("_NO_LINK") else lambda *_, **__: None
        monkeypatch.setattr(f"usdface.{guard}", off)
    assert walk(way, shot, outside)


SYSTEM = [Path(sys.prefix), Path(sys.base_prefix), Path(usdface.__file__).parents[2]] + [
    Path(each) for each in ("/dev", "/etc", "/proc", "/sys", "/usr")
]
"""Where Python, its libraries and the package's own files are."""


def test_a_confined_run_opens_nothing_outside(
    shot: Shot, outside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shot.folder)
    monkeypatch.setenv(ROOT_VARIABLE, str(shot.folder))
    # Elsewhere it is read from a file of the run.
    monkeypatch.setattr("usdface.steps.capture.ingest.judge_markers", judge_markers)
    lines = [
        "ingest shot.c3d --out n.take.usda",
        "edit shot.hero.usda --shape jawOpen --add 0.2 --frames 9-20",
        "bake shot.hero.usda --out baked.usdc",
        "package shot.hero.usda --out shot.usdz",
        "validate shot.hero.usda",
    ]
    with opened_by_python() as opened, touched_by_anything(outside, shot.folder.parent) as touched:
        for line in lines:
            with pytest.raises(SystemExit, match="0"):
                main(line.split())
    allowed = [shot.folder, *SYSTEM]
    away = {path for path in opened if not any(path.is_relative_to(each) for each in allowed)}
    assert not away
    assert {name for name in touched if name != shot.folder.name} <= {""}
