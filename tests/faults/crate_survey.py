"""How reading damaged binary layers and packages ends, counted.

`python -m tests.faults.crate_survey` prints the table that `docs/security.md` quotes; with
``--unguarded``, what it would be if usdface left all looking to USD.
"""

import argparse
import resource
import shutil
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Sdf

from tests.faults.crate_damage import CRATE_DAMAGES, PACKAGE_DAMAGES, Damage, Sound
from tests.faults.layer_reader import LayerReader
from tests.faults.layer_readers import READERS, film
from tests.faults.world import build_world

SLOW_SECONDS = 2.0


@dataclass(frozen=True)
class Subject:
    """What is read, the file that is opened, and the one that is damaged: it, or one below it."""

    reader: str
    opened: str
    damaged: str


@dataclass
class Tally:
    """How reading ended, by how often, and in words where it should not have ended so.

    Attributes
    ----------
    ends : Counter
        ``read``, ``refused``; ``unnamed``, ``escaped``: faults of ours; ``ended``, ``hung``: the
        process was ended, or did not answer.
    slow : int
        Answers that took more than two seconds.
    told : list of str
    """

    ends: Counter[str] = field(default_factory=Counter)
    slow: int = 0
    told: list[str] = field(default_factory=list)


BESIDES = (
    Subject("validate", "hero.usdc", "hero.usdc"),
    Subject("validate", "shot.hero.usda", "shot.hero.weights.usdc"),
    Subject("files", "shot.hero.usda", "shot.hero.weights.usdc"),
    Subject("posed", "shot.hero.usda", "shot.hero.weights.usdc"),
    Subject("posed", "shot.hero.usda", "hero.usdc"),
)
"""Binary layers that are read from below another."""

PACKAGES = tuple(
    Subject(reader, "shot.usdz", "shot.usdz")
    for reader in ("weight table", "source", "range", "rig", "files", "validate")
)
NOT_ALONE = ("alpha",)
"""Readers whose layer in the finished shot has nothing for them."""


def lay_out(world: Path, folder: Path) -> tuple[Subject, ...]:
    """Copy a finished shot, its text layers as binary ones beside, and name what can be damaged."""
    shutil.copytree(world, folder, ignore=shutil.ignore_patterns("*.c3d", "*.mov", "*.mp4"))
    film(folder / "filmed.usda")
    subjects = []
    for name, (opened, damaged, _) in READERS.items():
        if damaged.endswith(".usdc"):
            subjects.append(Subject(name, opened, damaged))
        elif opened == damaged and name not in NOT_ALONE:
            binary = Path(opened).with_suffix(".usd").name
            text = Sdf.Layer.OpenAsAnonymous(str(folder / opened))
            text.Export(str(folder / binary), args={"format": "usdc"})
            subjects.append(Subject(name, binary, binary))
    return (*subjects, *BESIDES)


def survey(
    reader: LayerReader,
    folder: Path,
    subjects: Iterable[Subject],
    damages: Iterable[Damage],
    *,
    each: int,
) -> dict[str, Tally]:
    """Damage every subject in every way, `each` times, and count by damage how reading it ends."""
    found = {damage.__name__: Tally() for damage in damages}
    for subject in subjects:
        path = folder / subject.damaged
        content = path.read_bytes()
        other = next(
            file.read_bytes()
            for file in sorted(folder.glob(f"*{path.suffix}"))
            if file != path or path.suffix == ".usdz"
        )
        answer = reader.ask(subject.reader, folder / subject.opened)
        if answer != "read":
            raise ValueError(f"{subject} is not read while it is sound: {answer}")
        for damage in damages:
            for index in range(each):
                named = f"{subject.reader} {subject.damaged} {damage.__name__}"
                rng = np.random.default_rng([zlib.crc32(named.encode()), index])
                path.unlink()  # a file of its own: what was mapped before stays as it was
                path.write_bytes(damage(rng, Sound(content, other)))
                start = time.monotonic()
                answer = reader.ask(subject.reader, folder / subject.opened)
                tally = found[damage.__name__]
                tally.slow += time.monotonic() - start > SLOW_SECONDS
                end = answer.partition(":")[0]
                tally.ends[end] += 1
                if end not in ("read", "refused"):
                    tally.told.append(f"{named} {index}: {answer}")
        path.unlink()
        path.write_bytes(content)
    return found


def table(found: Mapping[str, Tally]) -> str:
    """Return a table in Markdown, a row for every damage and one for all."""
    columns = ("read", "refused", "unnamed", "escaped", "ended", "hung")
    lines = [f"| damage | {' | '.join(columns)} | slow |", "|---|" + "---:|" * 7]
    every = Tally(
        sum((tally.ends for tally in found.values()), Counter()),
        sum(tally.slow for tally in found.values()),
    )
    for name, tally in (*found.items(), ("all", every)):
        figures = " | ".join(str(tally.ends[column]) for column in columns)
        lines.append(f"| {name} | {figures} | {tally.slow} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, and what ended as it should not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=40, help="files for a damage and a reader")
    parser.add_argument("--unguarded", action="store_true", help="leave all looking to USD")
    parser.add_argument("--world", type=Path, help="a finished shot; made where it is not given")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        world = given.world
        if world is None:
            world = Path(temporary) / "world"
            world.mkdir()
            build_world(world)
        folder, scratch = Path(temporary) / "damaged", Path(temporary) / "scratch"
        scratch.mkdir()
        subjects = lay_out(world, folder)
        with LayerReader(scratch, guarded=not given.unguarded) as reader:
            found = survey(reader, folder, subjects, CRATE_DAMAGES, each=given.each)
            packages = survey(reader, folder, PACKAGES, PACKAGE_DAMAGES, each=given.each)
    found |= {f"package: {name}": tally for name, tally in packages.items()}
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    print(table(found))  # noqa: T201
    print(*(each for tally in found.values() for each in tally.told), sep="\n")  # noqa: T201
    print(f"at most {most:.1f} GiB in a process")  # noqa: T201


if __name__ == "__main__":
    main()
