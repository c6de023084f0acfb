"""Safe opening of movie and sound files."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import av.error

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError

MAX_PIXELS = 8192 * 8192
"""Largest size of a movie's pictures."""

# Without playlists and scripts (hls, concat, …), which name other files and hosts; the only
# protocol allowed is plain files.
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mxf,mpegts,mpeg,mpegvideo,"
    "wav,w64,aiff,flac,mp3,ogg,caf,aac"
)

# PyAV 19 decodes invalid bytes with surrogateescape; earlier versions need the option.
_LENIENT: dict[str, Any] = (
    {"metadata_errors": "surrogateescape"} if int(av.__version__.partition(".")[0]) < 19 else {}
)


def open_media(path: Path) -> Any:
    """Open a media file for reading."""
    check_may_open(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; copy or export it again")
    options = {
        "protocol_whitelist": "file",
        "format_whitelist": _FORMATS,
        "max_pixels": str(MAX_PIXELS),  # FFmpeg decodes pictures when it opens a file
    }
    with decoding(path):
        # Absolute, so that a name is not parsed as a protocol.
        return av.open(str(path.absolute()), options=options, **_LENIENT)


def metadata_of(holder: Any) -> dict[str, str]:
    """Return metadata of a container or stream by lower-case key; invalid bytes as ``?``."""
    return {
        str(key).lower(): str(value).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        for key, value in holder.metadata.items()
    }


@contextlib.contextmanager
def decoding(path: Path, *, where: str = "") -> Iterator[None]:
    """Raise errors of FFmpeg in the block as `unreadable`."""
    try:
        yield
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise unreadable(path, error, where=where) from error


def unreadable(path: Path, error: Exception, *, where: str = "") -> InputError:
    """Return the error for a file that cannot be decoded."""
    reason = getattr(error, "strerror", None) or str(error)
    return InputError(
        f"{path}:{where} cannot be read as a movie or sound ({reason}); it may be cut short or of "
        "another format: copy it again, or export H.264, ProRes or WAV"
    )


def start_seconds(container: Any) -> float:
    """Return the time stamp that players show as zero: the first of all streams [s]."""
    return 0.0 if container.start_time is None else float(container.start_time) / av.time_base
