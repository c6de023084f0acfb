"""Readers of layers in a process of their own, bounded in memory and time.

USD reads binary layers in C++: damage may end the process, or hold it for ever, and both must be
seen by a test that goes on.

`python -m tests.faults.layer_reader` answers each file that it is told with one line.
"""

import faulthandler
import json
import os
import resource
import select
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

ROOM = 2 << 30
"""What reading one small layer may ask for beyond what the libraries themselves take [bytes]."""
LONGEST_SECONDS = 60.0
UNGUARDED = "--unguarded"


class LayerReader:
    """A process that reads what it is told, and is started anew when a file ended it.

    Parameters
    ----------
    scratch : Path
        Where USD may leave its notes on a process that it ends.
    guarded : bool
        False leaves out what usdface looks at before USD opens a layer.
    """

    def __init__(self, scratch: Path, *, guarded: bool = True) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._scratch = scratch
        self._command = [sys.executable, "-m", "tests.faults.layer_reader"]
        if not guarded:
            self._command.append(UNGUARDED)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def ask(self, reader: str, opened: Path) -> str:
        """Return ``read``, ``refused: …`` or, for what must not be, how reading ended.

        Parameters
        ----------
        reader : str
            Of `tests.faults.layer_readers`.
        opened : Path
            It, or one beside it, is to be named where it is refused.
        """
        process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps([reader, str(opened)]).encode() + b"\n")
        process.stdin.flush()
        if not select.select([process.stdout], [], [], LONGEST_SECONDS)[0]:
            self._end()
            return f"hung: no answer in {LONGEST_SECONDS:g} s"
        answer = process.stdout.readline().decode(errors="replace").strip()
        if answer:
            return answer
        code = process.wait()
        self._end()
        return f"ended: the process ended with {code}"

    def _start(self) -> subprocess.Popen[bytes]:
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=Path(__file__).resolve().parents[2],
            env=os.environ
            | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PXR_WORK_THREAD_LIMIT": "1"}
            | {"TMPDIR": str(self._scratch)},
        )
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        self._process = None


def _where(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"


def _answer(read: Callable[[Path], object], opened: Path) -> str:
    from usdface.errors import InputError

    try:
        read(opened)
    except InputError as error:
        return f"{'refused' if str(opened.parent) in str(error) else 'unnamed'}: {error}"
    except BaseException as error:  # this is what a test looks for
        return f"escaped: {type(error).__name__}: {error} ({_where(error)})"
    return "read"


def main() -> None:
    """Answer every line."""
    from tests.faults.layer_readers import READERS_BY_NAME
    from usdface.usdio import layers

    if UNGUARDED in sys.argv:
        vars(layers).update(check_crate=lambda path: None, check_crates_below=lambda layer: None)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    faulthandler.enable()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, used + ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in sys.stdin:
        reader, opened = json.loads(line)
        told = _answer(READERS_BY_NAME[reader], Path(opened))
        print(" ".join(told.split())[:500], flush=True, file=answers)


if __name__ == "__main__":
    main()
