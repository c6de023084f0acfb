"""Readers of movies, sound and pictures in a process of their own, bounded in memory.

They call libraries written in C++: what goes wrong there may end the process, or ask for more
memory than a machine has, and both must be seen by a test that goes on.

`python -m tests.faults.media_reader` answers each path that it is told with one line.
"""

import faulthandler
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Self

ROOM = 2 << 30
"""What reading one small file may ask for beyond what the libraries themselves take [bytes]."""
LONGEST_SECONDS = 30.0
MOST_FRAMES_SHOWN = 4


class MediaReader:
    """A process that reads what it is told, and is started anew when a file ended it."""

    def __init__(self) -> None:
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
            answer = self._answers.get(timeout=LONGEST_SECONDS)
        except Empty:
            self._end()
            return f"hung: no answer in {LONGEST_SECONDS:g} s"
        if answer:
            return answer
        code = process.wait()
        self._end()
        return f"ended: the process ended with {code}"

    def _start(self) -> subprocess.Popen[str]:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.faults.media_reader"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=Path(__file__).resolve().parents[2],
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
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


def read_movie(path: Path) -> None:
    from usdface.media.image_sequence import open_video

    with open_video(path, Fraction(24)) as video:
        count = len(video.times)
        for index in {0, count // 2, count - 1, *range(min(count, MOST_FRAMES_SHOWN))}:
            video.frame_at(float(video.times[index]))


def read_sound(path: Path) -> None:
    from usdface.media.sound import read_audio

    read_audio(path)


def join_parts(path: Path) -> None:
    from usdface.media.movie_join import join_movies

    with tempfile.TemporaryDirectory() as folder:
        join_movies(Path(folder) / path.with_suffix(".mkv").name, [path, path])


def read_still(path: Path) -> None:
    from usdface.media.picture import read_picture

    read_picture(path)


def read_what_it_says(path: Path) -> None:
    from usdface.media.image import read_image_metadata

    read_image_metadata(path)


def read_view(path: Path) -> None:
    import numpy as np

    from usdface.media.display_view import display_view

    os.environ["OCIO"] = str(path)
    display_view("sRGB/Film")(np.linspace(0, 1, 48).reshape(4, 4, 3))


def end(path: Path) -> None:
    """What a fault in a library does."""
    os._exit(3)


READERS: dict[str, Callable[[Path], None]] = {
    "movie": read_movie,
    "sound": read_sound,
    "join": join_parts,
    "picture": read_still,
    "metadata": read_what_it_says,
    "view": read_view,
    "end": end,
}


def main() -> None:
    """Answer every line."""
    import av  # noqa: F401 - all libraries are there before memory is counted
    import numpy as np  # noqa: F401
    import OpenImageIO  # noqa: F401

    from usdface.errors import InputError

    answers = os.fdopen(os.dup(1), "w")
    said = tempfile.TemporaryFile()
    os.dup2(said.fileno(), 1)
    faulthandler.enable()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, used + ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in sys.stdin:
        reader, name = json.loads(line)
        try:
            READERS[reader](Path(name))
            answer = "read"
        except InputError as error:
            answer = "refused" if Path(name).name in str(error) else "unnamed"
            answer += f": {error}"
        except Exception as error:  # this is what a test looks for
            where = error.__traceback__
            while where is not None and where.tb_next is not None:
                where = where.tb_next
            at = "" if where is None else f"{where.tb_frame.f_code.co_filename}:{where.tb_lineno}"
            answer = f"escaped: {type(error).__name__}: {error} ({at})"
        if said.seek(0, os.SEEK_END):  # `--json` belongs to scripts
            said.seek(0)
            answer = f"noisy: {said.read()!r} on standard output, then {answer}"
            said.truncate(0)
            os.lseek(1, 0, os.SEEK_SET)
        print(" ".join(answer.split())[:500], flush=True, file=answers)


if __name__ == "__main__":
    main()
