"""Cost of commands, each in a process of its own."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ONE_THREAD = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Environment of commands whose processor time is compared."""

_LAUNCH = """
import json, os, subprocess, sys, time
begun = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
process.returncode = os.waitstatus_to_exitcode(status)
elapsed = time.perf_counter() - begun
print(json.dumps([process.returncode, used.ru_utime + used.ru_stime, elapsed, used.ru_maxrss]))
"""
"""Small intermediate process, since Linux counts the parent's memory in the child's peak."""


@dataclass(frozen=True)
class Cost:
    """Processor and elapsed time of a process and its children [s], peak memory [MB]."""

    seconds: float
    elapsed: float
    peak_mb: float


def measure(folder: Path, *command: str, environment: dict[str, str] = ONE_THREAD) -> Cost:
    """Run a command in a folder; `SystemExit` if it fails."""
    done = subprocess.run(
        [sys.executable, "-c", _LAUNCH, *command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    code, seconds, elapsed, peak_kb = json.loads(done.stdout)
    if code:
        raise SystemExit(f"{' '.join(command)[:200]} ended with {code}: {done.stderr[-500:]}")
    return Cost(seconds, elapsed, peak_kb / 1024)


def measure_usdface(folder: Path, words: str) -> Cost:
    """Run a command of usdface in a folder, with one thread."""
    return measure(folder, sys.executable, "-m", "usdface", *words.split())
