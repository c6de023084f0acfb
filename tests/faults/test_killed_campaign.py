"""Every command that writes, killed at random times while it replaces what it wrote before.

What was there is from other options, so that every file tells which run it is from: after a kill,
every file is whole, all layers are of the run before or all are of the new one (a picture that is
drawn of them may still be older), and nothing else in the folder changed.
Commands run in processes forked from one that has imported everything, so that kills fall into
their work. `USDFACE_KILLS` sets how many each gets.
"""

import contextlib
import json
import os
import shlex
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

from tests.faults.commands import ALL_STEPS, COMMANDS, HERO, MAP, RIG, contents, leftovers
from tests.faults.conftest import together
from tests.faults.forked_command import forking, run_forked
from tests.faults.world import World, copy_of, steps_here
from usdface.core.sidecars import LAYER_SUFFIXES

pytestmark = pytest.mark.faults

KILLS = int(os.environ.get("USDFACE_KILLS", "50"))
ENDED_SECONDS = 20
"""Within which every process that a killed command started has to have ended."""

OTHER_COMMANDS = {
    "edit": f"edit {HERO} --shape jawOpen --override 0.2 --frames 100-140 --fade 5",
    "edits-import": f"edits import {HERO} --changed changed.usdc",
    "names": f"names {RIG} --out hero.names.csv",
    "submit": "submit shot.job.yaml --write-only --out bundle",
}
"""Commands that write and are no step of a job. `run` and `demo` run steps, each of which is here;
`tune` is killed by its own tests."""

CHANGED = {
    "ingest": ("--neutral 31", "--neutral 40"),
    "track": ("--frames 1-12", "--frames 1-10"),
    "align": ("--by sound", "--offset 1.7"),
    "clean": ("--out", "--no-smooth --out"),
    "phones": ("voice.txt", "other_voice.txt"),
    "select": ("--count 24", "--count 26"),
    "references-import": ("keys.csv", "other_keys.csv"),
    "references-sheet": ("--pairs 1-2", "--pairs 1-3"),
    "references-coverage": ("--out", "--tuned-only --out"),
    "train": ("--method ridge", "--method rbf"),
    "map": ("--out", "--frames 1-300 --out"),
    "join": ("two.hero.usda", ""),
    "bake": (HERO, "one.hero.usda"),
    "package": (HERO, "one.hero.usda"),
    "combine": (HERO, "one.hero.usda two.hero.usda"),
    "references-from-edits": ("--count 3", "--count 2"),
    "references-add": ("--frames 333", "--frames 300"),
    "sheet": ("--rows 2", "--rows 1"),
    "movie": ("--height 64", "--height 72"),
    "movie-join": ("shot.mp4", "other.mp4"),
    "report": ("--worst 2", "--worst 1"),
    "evaluate": ("keys.csv", "other_keys.csv"),
    "place": ("--out", "--landmarks marks.csv --out"),
    "bind": ("--out", "--picture scan.jpg --quality draft --out"),
    "deform": ("--length-scale 30", "--length-scale 20"),
    "make-shapes": ("--count 3", "--count 2"),
    "logic": ("logic.csv", "other_logic.csv"),
    "pairs-propose": ("--out", "--match name --out"),
    "pairs-import": ("--attributes rig/lattice.dfm:*", ""),
    "train-retarget": ("--method hybrid", "--method rbf"),
    "retarget": ("--out", "--frames 101-200 --out"),
    "cyclic": ("--every 20", "--every 15"),
    "make-sequence": ("150-190", "150-185"),
    "find-sequences": ("--threshold 0.01", "--threshold 0.02"),
    "warp": ("--blend 8", "--blend 6"),
    "faces": ("--rows 2", "--rows 1"),
    "edit": ("--override 0.2", "--override 0.4"),
    "edits-import": ("changed.usdc", "changed_more.usdc"),
    "names": ("--out", "--names fewer.names.csv --out"),
    "submit": ("shot.job.yaml", "other.job.yaml"),
}
"""What of a command is replaced by what, for outputs that differ."""

KINDS = ("process", "group", "stopped group", "terminated group", "process")


@dataclass(frozen=True)
class Campaign:
    """A folder with what a command wrote, and what another run of it writes instead.

    Attributes
    ----------
    folder : Path
    words : str
        The command of that other run.
    before, after : dict
        Every file, before and after it.
    seconds : float
        How long it takes, undisturbed.
    """

    folder: Path
    words: str
    before: dict[str, bytes]
    after: dict[str, bytes]
    seconds: float

    @property
    def outputs(self) -> list[str]:
        """Files that the run replaces, makes or removes."""
        names = self.before.keys() | self.after.keys()
        return sorted(name for name in names if self.before.get(name) != self.after.get(name))

    def restore(self) -> None:
        """Undo the run, but for hidden files, which a later run has to clear."""
        for name in self.outputs:
            if name in self.before:
                (self.folder / name).write_bytes(self.before[name])
            else:
                (self.folder / name).unlink(missing_ok=True)


def start(campaign_folder: Path, words: str) -> BaseProcess:
    """Start a command as the leader of a group of processes."""
    context = forking()
    arguments = [*shlex.split(words), "--overwrite"]
    if words.split()[0] not in ("names", "submit"):
        arguments += ["--progress", "none"]
    process = context.Process(target=run_forked, args=(str(campaign_folder), arguments))
    process.start()
    return process


@pytest.fixture(scope="module")
def killed_world(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The world, with inputs for the second runs."""
    folder = copy_of(world.folder, tmp_path_factory.mktemp("campaign") / "world")
    head, *rows = (folder / "keys.csv").read_text().splitlines()
    halved = [
        ",".join([frame, *(str(0.5 * float(value)) for value in values)])
        for frame, *values in (row.split(",") for row in rows)
    ]
    (folder / "other_keys.csv").write_text("\n".join([head, *halved]) + "\n")
    words = (folder / "voice.txt").read_text().split() if (folder / "voice.txt").exists() else []
    (folder / "other_voice.txt").write_text(" ".join(words[:-1]))
    (folder / "other_logic.csv").write_text("shape,parts\nmouthLeft,jawOpen mouthFunnel\n")
    (folder / "marks.csv").write_text("marker,point\nnose_tip,skin:100\n")
    finish(folder, f"{MAP} --frames 1-240 --out one.hero.usda")
    finish(folder, f"{MAP} --frames 241-480 --out two.hero.usda")
    finish(folder, COMMANDS["movie"].replace("1-48", "49-96").replace("shot.mp4", "other.mp4"))
    finish(folder, f"names {RIG} --out fewer.names.csv")
    names = (folder / "fewer.names.csv").read_text().splitlines(keepends=True)
    (folder / "fewer.names.csv").write_text("".join(names[:-2]))
    job = (folder / "shot.job.yaml").read_text()
    (folder / "other.job.yaml").write_text(job.replace("job: shot", "job: other"))
    finish(folder, "bake edited.hero.usda --out changed.usdc")
    finish(folder, "edit edited.hero.usda --shape jawOpen --add 0.3 --frames 100-140")
    finish(folder, "bake edited.hero.usda --out changed_more.usdc")
    return folder


def finish(folder: Path, words: str) -> float:
    """Run a command to its end, which must be a good one, and return how long it took [s]."""
    begun = time.perf_counter()
    process = start(folder, words)
    process.join()
    told = (folder / ".stderr").read_text()
    assert process.exitcode == 0, f"{words}\n{told}"
    (folder / ".stderr").unlink()
    return time.perf_counter() - begun


def here() -> list[str]:
    """Every command that can be run here."""
    return [name for name in CHANGED if name in OTHER_COMMANDS or name in steps_here()]


@pytest.fixture(scope="module", params=together(here()))
def campaign(
    request: pytest.FixtureRequest, killed_world: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Campaign]:
    """A folder in which both runs of a command have been, and the first is the last."""
    step = request.param
    folder = copy_of(killed_world, tmp_path_factory.mktemp(step) / "Schuss 1 ü")
    words = (COMMANDS | OTHER_COMMANDS)[step]
    assert CHANGED[step][0] in words
    changed = words.replace(*CHANGED[step], 1)
    finish(folder, words)
    before = contents(folder)
    seconds = finish(folder, changed)
    found = Campaign(folder, changed, before, contents(folder), seconds)
    assert found.outputs, "both runs wrote the same"
    found.restore()
    found = replace(found, seconds=min(seconds, finish(folder, changed)))
    found.restore()
    yield found
    shutil.rmtree(folder)


def kill(process: BaseProcess, kind: str) -> None:
    """End a command, or its group, as a farm, a shell or a user does."""
    assert process.pid is not None
    last = signal.SIGTERM if kind == "terminated group" else signal.SIGKILL
    try:
        if kind == "stopped group":
            os.killpg(process.pid, signal.SIGSTOP)
            time.sleep(0.05)
        if kind != "process":
            os.killpg(process.pid, last)
    except ProcessLookupError:  # it has just ended, or does not lead its group yet
        kind = "process"
    if kind == "process":
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, last)


def wait_for_group(process: BaseProcess) -> None:
    """Wait until the command and all that it started have ended."""
    process.join(ENDED_SECONDS)
    assert process.exitcode is not None, "still runs"
    for _ in range(10 * ENDED_SECONDS):
        try:
            os.killpg(process.pid or 0, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.killpg(process.pid or 0, signal.SIGKILL)
    raise AssertionError("a process of a killed command lives on")


def state_of(campaign: Campaign) -> str:
    """Return whether the layers are those before or after; fail if a file is neither."""
    now = contents(campaign.folder)
    # A tuning lock of a killed process holds nobody off; the next run takes it away.
    now = {name: content for name, content in now.items() if not name.endswith(".tuned.lock")}
    seen: dict[bool, set[str]] = {True: set(), False: set()}
    for name in now.keys() | campaign.before.keys() | campaign.after.keys():
        content, old, new = now.get(name), campaign.before.get(name), campaign.after.get(name)
        if name not in campaign.outputs:
            assert content == old, f"{name} is no output, and changed"
        else:
            assert content in (old, new), f"{name} is neither old nor new"
            seen[Path(name).suffix in LAYER_SUFFIXES].add("old" if content == old else "new")
    return "/".join(sorted(seen[True] or seen[False]))


def test_outputs_are_those_before_or_after(campaign: Campaign, capsys) -> None:
    rng = np.random.default_rng(0)
    told: Counter[str] = Counter()
    hidden: Counter[str] = Counter()
    for number in range(KILLS):
        kind = KINDS[number % len(KINDS)]
        process = start(campaign.folder, campaign.words)
        earliest = 0.7 if number % 2 else 0.0  # half of them near the end, where files are written
        time.sleep(float(rng.uniform(earliest, 1.05)) * campaign.seconds)
        if process.is_alive():
            kill(process, kind)
        wait_for_group(process)
        ended = process.exitcode
        stderr = campaign.folder / ".stderr"
        said = stderr.read_text() if stderr.exists() else ""
        assert ended in (0, 3) or (ended is not None and ended < 0), f"ended with {ended}: {said}"
        assert "Traceback" not in said
        stderr.unlink(missing_ok=True)
        state = state_of(campaign)
        told[f"{kind}: {'done' if ended == 0 else state}"] += 1
        hidden["left hidden files"] += bool(leftovers(campaign.folder))
        campaign.restore()
    finish(campaign.folder, campaign.words)
    assert state_of(campaign) == "new"
    assert leftovers(campaign.folder) == []
    assert list(campaign.folder.glob("*.tuned.lock")) == []
    with capsys.disabled():
        sys.stderr.write(f"\n{campaign.words}\n  {json.dumps(told)}, {json.dumps(hidden)}\n")
    mixed = [name for name in told if "new/old" in name]
    assert not mixed, f"some files are old and some new after {mixed}"


def test_the_commands_are_of_steps() -> None:
    assert set(CHANGED) == {*ALL_STEPS, *OTHER_COMMANDS}
