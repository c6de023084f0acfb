"""Commands killed around each rename: a few of `poe faults`, where processes are forked."""

import signal
from pathlib import Path

from tests.faults.commands import COMMON, contents, leftovers
from tests.faults.forked_command import forking, run_forked
from tests.steps.small_shot import Shot


def ended(folder: Path, words: str, killed_at: int | None) -> int | None:
    process = forking().Process(
        target=run_forked, args=(str(folder), [*words.split(), *COMMON], killed_at)
    )
    process.start()
    process.join()
    (folder / ".stderr").unlink(missing_ok=True)
    return process.exitcode


def test_outputs_are_old_before_the_first_rename_and_new_after_the_last(shot: Shot) -> None:
    words, renames = "clean shot.take.usda --no-smooth --out shot.clean.take.usda", 2
    folder = shot.folder
    before = contents(folder)
    assert ended(folder, words, 0) == -signal.SIGKILL
    assert contents(folder) == before
    assert leftovers(folder) != []
    assert ended(folder, words, renames) == 0, "it renames no more often"
    after = contents(folder)
    changed = {name for name in after if after[name] != before.get(name)}
    assert len(changed) == renames
    assert before.keys() <= after.keys()
    assert leftovers(folder) == [], "what the killed one left"
    assert ended(folder, words, 0) == -signal.SIGKILL
    assert contents(folder) == after
