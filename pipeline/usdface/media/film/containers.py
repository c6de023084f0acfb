"""Open a movie or sound file that someone else made, trusting nothing in it."""

from pathlib import Path
from typing import Any

import av
import av.error

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError

MAX_PIXELS = 8192 * 8192
"""Of one picture of a movie."""

# Playlists and scripts (hls, concat, …) name other files and hosts: none of them is here, and no
# protocol but plain files is allowed.
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mxf,mpegts,mpeg,mpegvideo,"
    "wav,w64,aiff,flac,mp3,ogg,caf,aac"
)

# From 19, PyAV keeps bytes that are no text in a form of its own; before, it had to be told.
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
        "max_pixels": str(MAX_PIXELS),  # to open a file, FFmpeg unpacks some of its pictures
    }
    try:
        # Absolute, so that no name is taken for a protocol.
        return av.open(str(path.absolute()), options=options, **_LENIENT)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise unreadable(path, error) from error


def words_of(holder: Any) -> dict[str, str]:
    """Return what a container or a stream says of itself, by keys in lower case.

    Bytes that are no text become question marks: they could not be printed.
    """
    return {
        str(key).lower(): str(value).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        for key, value in holder.metadata.items()
    }


def unreadable(path: Path, error: Exception, *, where: str = "") -> InputError:
    """Return the error for a file that the decoder gave up on."""
    reason = getattr(error, "strerror", None) or str(error)
    return InputError(
        f"{path}:{where} cannot be read as a movie or sound ({reason}); it may be cut short or of "
        "another format: copy it again, or export H.264, ProRes or WAV"
    )


def start_seconds(container: Any) -> float:
    """Return the time stamp that players call zero: the first of any stream [s]."""
    return 0.0 if container.start_time is None else float(container.start_time) / av.time_base
