"""Readers of movies, sound and pictures in a process of their own, bounded in memory.

They call libraries written in C++: what goes wrong there may end the process, or ask for more
memory than a machine has, and both must be seen by a test that goes on.

`python -m tests.faults.media_reader` answers each path that it is told with one line.
"""

import json
import os
import sys
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

from tests.faults.child_reader import ChildReader, bound_memory, escaped

MOST_FRAMES_SHOWN = 4


class MediaReader(ChildReader):
    """Asks this module, run as a process."""

    def __init__(self) -> None:
        super().__init__("tests.faults.media_reader", seconds=30.0)


def read_movie(path: Path) -> None:
    from usdface.media.film.video import open_video

    with open_video(path, Fraction(24)) as video:
        count = len(video.times)
        for index in {0, count // 2, count - 1, *range(min(count, MOST_FRAMES_SHOWN))}:
            video.frame_at(float(video.times[index]))


def read_sound(path: Path) -> None:
    from usdface.media.film.sound import read_audio

    read_audio(path)


def join_parts(path: Path) -> None:
    from usdface.media.film.movie_join import join_movies

    with tempfile.TemporaryDirectory() as folder:
        join_movies(Path(folder) / path.with_suffix(".mkv").name, [path, path], rate=Fraction(24))


def read_still(path: Path) -> None:
    from usdface.media.picture.image import read_picture

    read_picture(path)


def read_what_it_says(path: Path) -> None:
    from usdface.media.picture.image import read_image_metadata

    read_image_metadata(path)


def read_view(path: Path) -> None:
    import numpy as np

    from usdface.media.picture.image import display_view

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

    from usdface.core.errors import InputError

    answers = os.fdopen(os.dup(1), "w")
    said = tempfile.TemporaryFile()
    os.dup2(said.fileno(), 1)
    bound_memory()
    for line in sys.stdin:
        reader, name = json.loads(line)
        try:
            READERS[reader](Path(name))
            answer = "read"
        except InputError as error:
            answer = "refused" if Path(name).name in str(error) else "unnamed"
            answer += f": {error}"
        except Exception as error:  # this is what a test looks for
            answer = escaped(error)
        if said.seek(0, os.SEEK_END):  # `--json` belongs to scripts
            said.seek(0)
            answer = f"noisy: {said.read()!r} on standard output, then {answer}"
            said.truncate(0)
            os.lseek(1, 0, os.SEEK_SET)
        print(" ".join(answer.split())[:500], flush=True, file=answers)


if __name__ == "__main__":
    main()
