"""The sound of a take, on the clock of a movie made from it."""

import numpy as np

from usdface.assets import Float32Array, Take
from usdface.errors import InputError
from usdface.media.sound import read_audio
from usdface.steps.movie_clock import MovieClock

SAMPLE_RATE = 48000


def take_sound(take: Take, clock: MovieClock, notes: list[str]) -> Float32Array | None:
    """Return the sound that belongs to a movie's pictures: the capture's own, else the camera's.

    Parameters
    ----------
    take : Take
    clock : MovieClock
    notes : list of str
        What could not be had is added here.

    Returns
    -------
    (samples,) float32 array or None
        Mono at `SAMPLE_RATE`, as long as the pictures; silent where there is none.
    """
    start = (clock.first_frame - take.first_frame) / float(take.rate)
    count = round(float(clock.picture_count / clock.rate) * SAMPLE_RATE)
    moments = start + np.arange(count) / SAMPLE_RATE
    if take.audio is not None:
        file = take.audio
    elif take.video is not None and take.video.file.is_file():
        file = take.video.file
        moments = (moments - take.video.offset) / (1.0 + take.video.drift * 1e-6)
    else:
        return None
    try:
        recorded = read_audio(file, rate=SAMPLE_RATE)
    except InputError as error:
        notes.append(f"no sound: {error}")
        return None
    at = moments * SAMPLE_RATE
    heard = np.interp(at, np.arange(len(recorded)), recorded, left=0.0, right=0.0)
    return heard.astype(np.float32)
