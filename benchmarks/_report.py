"""Storage of benchmark output: Markdown and JSON, with a description of the machine."""

import contextlib
import io
import json
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from benchmarks._index import write_index

PACKAGES = ("numpy", "scipy", "usd-core", "OpenImageIO", "embreex", "av", "usdface")


class Tee(io.TextIOBase):
    """Passes text on and records it."""

    def __init__(self, beyond: io.TextIOBase) -> None:
        self._beyond = beyond
        self._kept: list[str] = []

    def write(self, text: str) -> int:
        self._kept.append(text)
        return self._beyond.write(text)

    def flush(self) -> None:
        self._beyond.flush()

    @property
    def text(self) -> str:
        return "".join(self._kept)


@contextlib.contextmanager
def kept_output() -> Iterator[Tee]:
    """Record what is printed, in addition to printing it."""
    tee = Tee(sys.stdout)  # type: ignore[arg-type]
    with contextlib.redirect_stdout(tee):
        yield tee


@dataclass(frozen=True)
class Measured:
    """Output and duration of a benchmark."""

    name: str
    text: str
    seconds: float
    load: float
    options: str = ""
    """Options of the command."""


def machine() -> dict[str, str]:
    """Return the properties of the machine that figures depend on."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].partition(":")[2].strip() if names else cpu
    return {
        "processor": cpu,
        "cores": str(os.cpu_count()),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


def write_report(folder: Path, results: list[Measured]) -> None:
    """Write NAME.md and NAME.json of each benchmark, and the index of all in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    about = machine()
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    for each in results:
        tables = read_tables(each.text)
        data = {
            "benchmark": each.name,
            "date": day,
            "seconds": round(each.seconds, 1),
            "load_before": round(each.load, 1),
            "machine": about,
            "tables": tables,
        }
        text = json.dumps(data, indent=2, ensure_ascii=False) + "\n"
        (folder / f"{each.name}.json").write_text(text, encoding="utf-8")
        page = (
            f"# {each.name}\n\n{each.text.strip()}\n\n"
            f"`python -m benchmarks {each.name}{each.options}`, {day}, {each.seconds:.0f} s, load "
            f"before {each.load:.1f}; {about['processor']}, {about['cores']} cores, Python "
            f"{about['python']}, NumPy {about['numpy']}, USD {about['usd-core']}.\n"
        )
        (folder / f"{each.name}.md").write_text(page, encoding="utf-8")
    write_index(folder)


def read_tables(text: str) -> list[list[dict[str, str]]]:
    """Return every Markdown table of a text as rows of cells by head."""
    tables: list[list[dict[str, str]]] = []
    head: list[str] | None = None
    for line in text.splitlines():
        if not line.startswith("|"):
            head = None
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if head is None:
            head = cells
            tables.append([])
        elif not all(set(cell) <= set("-: ") for cell in cells):
            tables[-1].append(dict(zip(head, cells, strict=False)))
    return tables
