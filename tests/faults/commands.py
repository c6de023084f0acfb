"""Steps of the small shot as commands in processes of their own, to be starved and killed."""

import os
import resource
import subprocess
import sys
from pathlib import Path

STEPS = {
    "ingest": "ingest shot.c3d --out shot.take.usda --neutral 31",
    "clean": "clean shot.take.usda --out shot.clean.take.usda",
    "select": "select shot.clean.take.usda --rig hero.usdc --count 24 --out hero.references.usda",
    "references import": "references import hero.references.usda --weights keys.csv",
    "train": "train hero.references.usda --method ridge --out hero.mapping.usdc",
    "map": "map shot.clean.take.usda --mapping hero.mapping.usdc --rig hero.usdc "
    "--out shot.hero.usda",
    "bake": "bake shot.hero.usda --out shot.baked.usdc",
    "sheet": "sheet shot.hero.usda --take shot.clean.take.usda --out shot.sheet.jpg --tile 48 "
    "--quality draft",
}


def start(
    folder: Path, words: str, *, limit: int | None = None, of: int = resource.RLIMIT_FSIZE
) -> subprocess.Popen[str]:
    """Start a command, with a limit on what it may use."""

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(of, (limit, limit))

    return subprocess.Popen(
        [sys.executable, "-m", "usdface", *words.split(), "--overwrite", "--progress", "none"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limited,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )


def finish(folder: Path, words: str) -> None:
    """Run a command to its end, which must be a good one."""
    process = start(folder, words)
    _, told = process.communicate()
    assert process.returncode == 0, told


def contents(folder: Path) -> dict[str, bytes]:
    """Every file that is not hidden, as it is."""
    return {
        each.name: each.read_bytes() for each in folder.iterdir() if not each.name.startswith(".")
    }


def leftovers(folder: Path) -> list[str]:
    """Hidden files: what a run that ended badly may leave, and the next one clears."""
    return sorted(each.name for each in folder.iterdir() if each.name.startswith("."))
