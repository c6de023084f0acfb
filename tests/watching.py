"""Sees what is opened: by Python anywhere, and by native code in some folders."""

import contextlib
import ctypes
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

_PATHS_OF = {  # where the events of `sys.addaudithook` name paths
    "open": (0,),
    "os.listdir": (0,),
    "os.scandir": (0,),
    "os.mkdir": (0,),
    "os.rmdir": (0,),
    "os.remove": (0,),
    "os.truncate": (0,),
    "os.utime": (0,),
    "os.rename": (0, 1),
    "os.link": (0, 1),
    "os.symlink": (0, 1),
    "shutil.rmtree": (0,),
    "tempfile.mkdtemp": (0,),
    "tempfile.mkstemp": (0,),
}
_watched: list[Path] | None = None
_is_hooked = False

_EVENTS = 0x1 | 0x2 | 0x20 | 0x40 | 0x80 | 0x100 | 0x200
"""Access, modify, open, moved from and to, create, delete: of <sys/inotify.h>."""


def _hook(event: str, given: tuple[object, ...]) -> None:
    if _watched is None:
        return
    for place in _PATHS_OF.get(event, ()):
        path = given[place] if place < len(given) else None
        # A name in an open folder says nothing alone; what it led to is seen by the other watch.
        if isinstance(path, str | bytes | os.PathLike) and Path(os.fsdecode(path)).is_absolute():
            _watched.append(Path(os.fsdecode(path)))


@contextlib.contextmanager
def opened_by_python() -> Iterator[list[Path]]:
    """Collect the absolute paths that Python opens, lists, makes or removes in a block."""
    global _watched, _is_hooked
    if not _is_hooked:  # it stays until the process ends
        sys.addaudithook(_hook)
        _is_hooked = True
    collected: list[Path] = []
    _watched = collected
    try:
        yield collected
    finally:
        _watched = None


@contextlib.contextmanager
def touched_by_anything(*folders: Path) -> Iterator[list[str]]:
    """Collect the names that any code, native included, opens or changes in folders (Linux)."""
    libc = ctypes.CDLL(None, use_errno=True)
    handle = libc.inotify_init1(os.O_NONBLOCK)
    names: list[str] = []
    try:
        for folder in folders:
            assert libc.inotify_add_watch(handle, os.fsencode(folder), _EVENTS) >= 0
        yield names
        with contextlib.suppress(BlockingIOError):
            while data := os.read(handle, 1 << 16):
                while data:
                    length = struct.unpack_from("iIII", data)[3]
                    names.append(data[16 : 16 + length].rstrip(b"\0").decode())
                    data = data[16 + length :]
    finally:
        os.close(handle)
