"""A process that reads files for a test, bounded in memory, and begun anew when one ended it."""

import faulthandler
import json
import os
import resource
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Self

ROOM = 2 << 30
"""What reading one small file may ask for beyond what the libraries themselves take [bytes]."""


class ChildReader:
    """Asks a module, run as a process, to read one file after the other.

    Parameters
    ----------
    module : str
        Answers each line of ``[reader, path]`` on standard input with one line.
    options : sequence of str
        Of its command line.
    environment : mapping
        Beside this process's own.
    seconds : float
        After which a file counts as one that is never answered.
    """

    def __init__(
        self,
        module: str,
        *,
        seconds: float,
        options: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._command = [sys.executable, "-m", module, *options]
        self._environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._environment |= environment or {}
        self._seconds = seconds
        self._process: subprocess.Popen[str] | None = None
        self._answers: SimpleQueue[str] = SimpleQueue()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def ask(self, reader: str, path: Path) -> str:
        """Return ``read``, ``refused: …`` or, for what must not be, how reading ended."""
        process = self._process or self._start()
        assert process.stdin is not None
        process.stdin.write(json.dumps([reader, str(path)]) + "\n")
        process.stdin.flush()
        try:
            answer = self._answers.get(timeout=self._seconds)
        except Empty:
            self._end()
            return f"hung: no answer in {self._seconds:g} s"
        if answer:
            return answer
        code = process.wait()
        self._end()
        return f"ended: the process ended with {code}"

    def _start(self) -> subprocess.Popen[str]:
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            encoding="utf-8",
            errors="replace",
            cwd=Path(__file__).resolve().parents[2],
            env=os.environ | self._environment,
        )
        self._answers = SimpleQueue()
        Thread(target=_listen, args=(self._process, self._answers), daemon=True).start()
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        self._process = None


def _listen(process: subprocess.Popen[str], answers: "SimpleQueue[str]") -> None:
    """Pass lines on; an empty one tells that the process has ended."""
    assert process.stdout is not None
    for line in process.stdout:
        answers.put(line.strip())
    answers.put("")


def bound_memory() -> None:
    """Limit what this process may ask for from now on; say on standard error where it ended."""
    faulthandler.enable()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, used + ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def escaped(error: BaseException) -> str:
    """Tell of an error that is none of ours: what it was, and where."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    at = "" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
    return f"escaped: {type(error).__name__}: {error} ({at})"
