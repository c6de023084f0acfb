"""Every step as a command in a process of its own, to be starved, killed and misled."""

import os
import resource
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from tests.small_scan import landmarks, small_scan
from usdface.specs.job import STEP_SPECS

ALL_STEPS = tuple(spec.model_fields["step"].default for spec in STEP_SPECS)

TAKE, RIG, HERO = "shot.clean.take.usda", "hero.usdc", "shot.hero.usda"
SCAN = "talk.take.usda --mesh scan.usdc --binding scan.binding.usda"
MAP = f"map {TAKE} --mapping hero.mapping.usdc --rig {RIG}"

COMMANDS = {
    "ingest": "ingest shot.c3d --out shot.take.usda --neutral 31",
    "track": "track face.mp4 --out face.take.usda --model face_landmarker.task --frames 1-12",
    "align": "align kitchen.take.usda --by sound --picture kitchen.sync.png",
    "clean": f"clean shot.take.usda --out {TAKE}",
    "phones": "phones voice.wav --transcript voice.txt --out voice.TextGrid",
    "select": f"select {TAKE} --rig {RIG} --count 24 --out hero.references.usda",
    "references-import": "references import hero.references.usda --weights keys.csv",
    "references-sheet": "references sheet hero.references.usda --out pairs.jpg --pairs 1-2 "
    "--tile 64 --quality draft",
    "references-coverage": f"references coverage hero.references.usda {TAKE} --out covered.png",
    "train": "train hero.references.usda --method ridge --out hero.mapping.usdc",
    "map": f"{MAP} --out {HERO}",
    "join": "join one.hero.usda two.hero.usda --out joined.hero.usda",
    "bake": f"bake {HERO} --out shot.baked.usdc",
    "package": f"package {HERO} --out shot.usdz",
    "combine": f"combine {HERO} --out hero.takes.usda",
    "references-from-edits": "references from-edits edited.hero.usda "
    "--references hero.references.usda --count 3 --out second.references.usda",
    "references-add": f"references add {HERO} --references hero.references.usda --frames 333 "
    "--out third.references.usda",
    "sheet": f"sheet {HERO} --take {TAKE} --out shot.sheet.jpg --tile 64 --rows 2 --quality draft",
    "movie": f"movie {HERO} --take {TAKE} --out shot.mp4 --frames 1-48 --height 64 --rate 12 "
    "--workers 1",
    "movie-join": "movie-join shot.mp4 --out joined.mp4",
    "report": f"report {HERO} --take {TAKE} --out shot.html --frames 1-48 --height 120 --worst 2",
    "evaluate": f"evaluate {HERO} --against keys.csv --out shot.figures.json",
    "place": f"place {TAKE} --rig {RIG} --out hero.placement.usda",
    "bind": "bind talk.take.usda scan.usdc --out scan.binding.usda "
    f"--landmarks '{','.join(landmarks(small_scan()))}'",
    "deform": f"deform {SCAN} --out talk.scan.usda --length-scale 30",
    "make-shapes": f"make-shapes {SCAN} --count 3 --out scan.rig.usda --length-scale 30",
    "logic": f"logic {RIG} --definition logic.csv --out hero.logic.usda",
    "pairs-propose": "pairs propose --source human.usda --target beast.usda --out guess.pairs.usda",
    "pairs-import": "pairs import --source human_poses.usda --target beast_poses.usda "
    "--source-rig human.usda --target-rig beast.usda --attributes rig/lattice.dfm:* "
    "--out x.pairs.usda",
    "train-retarget": "train-retarget x.pairs.usda --method hybrid --out x.retarget.usdc",
    "retarget": "retarget shot.usda --retargeting x.retarget.usdc --out beast.shot.usda",
    "cyclic": "cyclic x.pairs.usda --source shot.usda --every 20 --methods rbf --out x.cyclic.json",
    "make-sequence": "make-sequence --source shot.usda --source-frames 150-190 --target own.usda "
    "--label joy --out joy.sequence.usda",
    "find-sequences": "find-sequences shot.usda --sequence joy.sequence.usda --by threshold "
    "--threshold 0.01 --out shot.matches.usda",
    "warp": "warp beast.shot.usda --matches shot.matches.usda --blend 8 --out warped.usda",
    "faces": "faces shot.usda beast.shot.usda --out faces.png --rows 2 --tile 64 --quality draft",
}
"""A small command for every step of a job; a test holds that none is missing."""

BEFORE = {
    "join": (f"{MAP} --frames 1-240 --out one.hero.usda", f"{MAP} --frames 241-480 --out "
             "two.hero.usda"),
    "references-from-edits": (
        f"{MAP} --out edited.hero.usda",
        "edit edited.hero.usda --shape jawOpen --add 0.2 --frames 100-140 --fade 5",
    ),
}  # fmt: skip
"""What some steps need besides what steps before them made."""

COMMON = ("--overwrite", "--progress", "none")


def command_line(words: str) -> list[str]:
    """Return the arguments of a process for a command; quotes keep blanks."""
    return [sys.executable, "-m", "usdface", *shlex.split(words), *COMMON]


def limited(amount: int, of: int = resource.RLIMIT_FSIZE) -> Callable[[], None]:
    """Return what a process does before it begins: limit itself."""
    return lambda: resource.setrlimit(of, (amount, amount))


def start(
    folder: Path,
    words: str,
    *,
    first: Callable[[], None] | None = None,
    python_path: Path | None = None,
) -> subprocess.Popen[str]:
    """Start a command, after what the process is to do first."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    if python_path is not None:
        before = environment.get("PYTHONPATH")
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(python_path), before)))
    return subprocess.Popen(
        command_line(words),
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=first,
        env=environment,
    )


def finish(folder: Path, words: str, *, python_path: Path | None = None) -> None:
    """Run a command to its end, which must be a good one."""
    process = start(folder, words, python_path=python_path)
    _, told = process.communicate()
    assert process.returncode == 0, f"{words}\n{told}"


def contents(folder: Path) -> dict[str, bytes]:
    """Every file that is not hidden, itself or by its folder, as it is."""
    found = {each.relative_to(folder): each for each in folder.rglob("*") if each.is_file()}
    return {
        name.as_posix(): each.read_bytes()
        for name, each in found.items()
        if not any(part.startswith(".") for part in name.parts)
    }


def leftovers(folder: Path) -> list[str]:
    """Hidden files: what a run that ended badly may leave, and the next one clears."""
    return sorted(each.name for each in folder.iterdir() if each.name.startswith("."))
