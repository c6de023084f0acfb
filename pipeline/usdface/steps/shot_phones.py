"""What is said at the frames of one take, as sheets and reports label it."""

from pathlib import Path

import numpy as np

from usdface.assets import IntArray, Take
from usdface.errors import InputError
from usdface.speech.phone_track import PhoneTrack, label_at
from usdface.speech.track_files import read_phone_track
from usdface.speech.visemes import SILENCE, arpabet_of, viseme_label, viseme_of

MARGIN_SECONDS = 5.0
"""By how much phones may outlast their take before they are thought to be of another."""


def said_at(phones: Path | None, take: Take, frames: IntArray) -> tuple[str, ...]:
    """Return the phone and the viseme of each frame, such as ``M  /b/ /p/ /m/``.

    Parameters
    ----------
    phones : Path or None
        On the take's clock; None leaves every label empty.
    take : Take
    frames : (frames,) int array

    Returns
    -------
    tuple of str
        Empty outside of the phones; with the emotion, where one is marked.

    Raises
    ------
    InputError
        If the file cannot be read, or lasts longer than the take.
    """
    if phones is None:
        return ("",) * len(frames)
    track = read_phone_track(phones)
    lasts = take.frame_count / float(take.rate)
    if track.duration > lasts + MARGIN_SECONDS:
        raise InputError(
            f"{phones}: lasts {track.duration:.1f} s and take {take.name} {lasts:.1f} s; give the "
            "phones of this take"
        )
    seconds = (np.asarray(frames) - take.first_frame) / float(take.rate)
    return tuple(_label(track, at) for at in seconds.tolist())


def _label(track: PhoneTrack, seconds: float) -> str:
    phone = label_at(track.phones, seconds)
    viseme = viseme_of(phone) if phone else None
    if viseme is None:
        said = ""
    elif viseme == SILENCE:
        said = "silent"
    else:
        said = f"{(arpabet_of(phone) or phone).upper()}  {viseme_label(viseme)}"
    return ", ".join(part for part in (said, label_at(track.emotions, seconds)) if part)
