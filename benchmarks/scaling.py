"""Scaling of single functions in frames, markers, references, shapes and points.

Each function is timed in one process with one thread, at sizes a factor of two or more apart, and a
power law is fitted. `scale` measures whole commands, with memory and disk space, and `whole_way`
their time relative to the bare write.
"""

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from benchmarks._log_plot import COLORS, Line, log_plot
from benchmarks._power_law import PowerLaw, fit_power_law
from benchmarks._scaling_subjects import SUBJECTS, Subject

REPOSITORY = Path(__file__).resolve().parents[1]


def run(*, quick: bool = False, pictures: Path | None = None) -> None:
    """Print an exponent per call; with a folder for pictures, also plot each measure of size.

    `quick` omits the largest sizes.
    """
    print(
        "Seconds of the processor, one thread. `measured` is the exponent of the power law fitted "
        "to all\nsizes, with its standard error; `at the end` that between the two largest alone, "
        "where what is paid\nonce weighs least. Linear is wanted as at most 1.1.\n"
    )
    print("| call, in | measured | wanted | at the end | sizes | seconds | fixed |")
    print("|---|---|---|---|---|---|---|")
    calls = list(dict.fromkeys(subject.call for subject in SUBJECTS))
    lines: dict[str, list[Line]] = defaultdict(list)
    for subject, sizes, seconds in _measured(quick=quick):
        law = fit_power_law(sizes, seconds)
        print(_row(subject, sizes, seconds, law), flush=True)
        label = f"{subject.call}: {law.exponent:.2f}"
        ends = law.seconds(sizes[0]), law.seconds(sizes[-1])
        color = COLORS[calls.index(subject.call) % len(COLORS)]  # the same in every plot
        lines[subject.within].append(Line(label, color, sizes, seconds, ends))
    if pictures is None:
        return
    print()
    for within, drawn in lines.items():
        name = f"scaling_{within}.svg"
        plot = log_plot(f"Time over {within}, and the exponent fitted", within, drawn)
        (pictures / name).write_text(plot, encoding="utf-8")
        print(f"![Processor time over {within}]({name})\n")


def _row(subject: Subject, sizes: list[int], seconds: list[float], law: PowerLaw) -> str:
    spread = "" if law.spread != law.spread else f" ± {law.spread:.2f}"
    cells = (
        f"{subject.call}, in {subject.within}",
        f"{law.exponent:.2f}{spread}",
        f"≤ {subject.most:g}",
        f"{law.last:.2f}",
        " ".join(f"{size:,}" for size in sizes),
        " ".join(f"{each:.2g}" if each < 10 else f"{each:.0f}" for each in seconds),
        subject.fixed,
    )
    return f"| {' | '.join(cells)} |"


def _measured(*, quick: bool) -> Iterator[tuple[Subject, list[int], list[float]]]:
    """Yield every subject's sizes and times, measured in a separate process."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks._scaling_subjects"]
    process = subprocess.Popen(
        [*command, *(["--quick"] if quick else [])],
        cwd=REPOSITORY,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    measured: dict[int, dict[int, float]] = defaultdict(dict)
    with process:
        for line in process.stdout or ():
            found = json.loads(line)
            number = found["subject"]
            measured[number][found["size"]] = found["seconds"]
            subject = SUBJECTS[number]
            if len(measured[number]) == len(subject.sizes) - quick:
                yield subject, list(measured[number]), list(measured[number].values())
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
