"""The sound that a capture system recorded on an analog channel, as a file that tools play."""

import filecmp
import re
import wave
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.capture.c3d import C3dFile, open_c3d
from usdface.capture.c3d_take import is_c3d
from usdface.core.errors import InputError
from usdface.core.replacing import replacing

SOUND_NAME = re.compile(r"audio|sound|mic|voice|speech", re.IGNORECASE)
LEAST_RATE = 4000.0
"""[Hz] Slower channels are force plates and switches: speech needs at least this."""

_CHUNK_FRAMES = 1 << 14


@dataclass(frozen=True)
class CaptureSound:
    """A sound file made from a capture, and what to say of it."""

    file: Path
    note: str


def extract_sound(
    sources: Sequence[Path],
    out: Path,
    *,
    channel: str | None = None,
    ours: bool = False,
    skipped: tuple[int, int] = (0, 0),
) -> CaptureSound | None:
    """Write the analog channel that holds sound as a WAV file.

    Parameters
    ----------
    sources : sequence of Path
        The captures of a take, in any order; only C3D carries analog channels.
    out : Path
        The WAV file to write.
    channel : str, optional
        Name of the channel; one that is named like sound by default.
    ours : bool
        Whether the file that may lie there already was made by this step.
    skipped : tuple of int
        Frames of the capture to leave out at its start and end.

    Returns
    -------
    CaptureSound or None
        None where there is no such channel and none was named.

    Raises
    ------
    InputError
        If no capture has the named channel, or the file cannot be written, or there is another
        that is not ours.
    """
    faults = list[str]()
    for source in sources:
        with source.open("rb") as stream:
            if not is_c3d(stream.read(512)):
                continue
        capture = open_c3d(source)
        names = [label.strip() for label in capture.analog_labels]
        faults.append(
            f"{source}: no analog channel {channel!r}; there are {', '.join(names) or 'none'}"
        )
        chosen = channel if channel in names else None
        if channel is None and capture.analog_rate >= LEAST_RATE:
            chosen = next((name for name in names if SOUND_NAME.search(name)), None)
        if chosen is not None:
            frames = range(skipped[0], capture.frame_count - skipped[1])
            _write_wav(out, capture, names.index(chosen), frames, ours=ours)
            rate = capture.analog_rate
            return CaptureSound(out, f"sound was taken from analog channel {chosen} ({rate:g} Hz)")
    if channel is None:
        return None
    if faults:
        raise InputError("\n".join(faults))
    raise InputError(
        f"{', '.join(map(str, sources))}: only C3D carries analog channels; leave "
        "--audio-channel out"
    )


def _write_wav(path: Path, capture: C3dFile, column: int, frames: range, *, ours: bool) -> None:
    """Write 16-bit samples, the loudest at full scale; two passes keep memory bounded."""
    starts = frames[::_CHUNK_FRAMES]

    def samples(start: int) -> np.ndarray:
        stop = min(start + _CHUNK_FRAMES, frames.stop)
        return capture.read_analog(start, stop)[:, column].astype(np.float64)

    total = sum(float(np.nansum(_numbers(samples(start)))) for start in starts)
    count = max(sum(int(np.isfinite(samples(start)).sum()) for start in starts), 1)
    middle = total / count  # a capture card's resting voltage is not sound

    def sound_from(start: int) -> np.ndarray:
        return np.nan_to_num(_numbers(samples(start)) - middle)  # a dropped sample is silent

    loudest = max((float(np.abs(sound_from(start)).max()) for start in starts), default=0.0)
    scale = 32767.0 / loudest if loudest > 0 else 0.0
    with replacing(path) as temporary:
        with wave.open(str(temporary), "wb") as stream:
            stream.setnchannels(1)
            stream.setsampwidth(2)
            stream.setframerate(round(capture.analog_rate))
            for start in starts:
                stream.writeframes(np.round(sound_from(start) * scale).astype("<i2").tobytes())
        # A run that was killed before it wrote its take left the same.
        if not ours and path.exists() and not filecmp.cmp(path, temporary, shallow=False):
            raise InputError(
                f"{path}: exists, and the take does not say that it is its sound; what the capture "
                "recorded goes there: move the file away, or name it with --audio"
            )


def _numbers(samples: np.ndarray) -> np.ndarray:
    """Return samples with NaN for all that is no number."""
    return np.where(np.isfinite(samples), samples, np.nan)
