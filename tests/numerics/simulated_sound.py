"""Speech-like sound, and what two recorders in a room make of one event."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import map_coordinates

Array = NDArray[np.float64]
RATE = 16000
_UP = 4  # finer grid for evaluating sound between its samples
_EDGE = 8  # samples of the finer grid beyond which cubic interpolation needs nothing


@dataclass(frozen=True)
class Recorder:
    """A microphone somewhere in the room, and the recorder it hangs on.

    Attributes
    ----------
    start : float
        When it begins to record [s].
    seconds : float
    rate : int
        Samples per second that it believes to take.
    ppm : float
        How much its clock is fast.
    snr_db : float
    reverb_seconds : float
        Time by which the room's answer has fallen by 60 dB; 0 for none.
    polarity : int
    """

    start: float
    seconds: float
    rate: int = RATE
    ppm: float = 0.0
    snr_db: float = 20.0
    reverb_seconds: float = 0.0
    polarity: int = 1


def speech(seconds: float, rng: np.random.Generator) -> Array:
    """Return syllables: voiced and breathy bursts through changing resonances, with pauses."""
    out = np.zeros(round(seconds * RATE))
    at = 0.05
    while at < seconds:
        length = rng.uniform(0.06, 0.25)
        count = round(length * RATE)
        time = np.arange(count) / RATE
        pitch = rng.uniform(90, 240) * (1 + rng.uniform(-0.3, 0.3) * time)
        voiced = signal.sawtooth(2 * np.pi * np.cumsum(pitch) / RATE)
        breath = rng.normal(size=count)
        mix = rng.random()
        source = mix * voiced + (1 - mix) * 0.5 * breath
        for centre in rng.uniform([250, 900, 2200, 3500], [900, 2200, 3500, 6500]):
            b, a = signal.iirpeak(centre, 4, fs=RATE)
            source = 0.3 * source + signal.lfilter(b, a, source)
        envelope = np.minimum(time / 0.01, 1) * np.exp(-2 * time / length)
        start = round(at * RATE)
        room = min(count, len(out) - start)
        out[start : start + room] += (rng.uniform(0.2, 1) * envelope * source)[:room]
        at += length + (rng.uniform(0.3, 0.8) if rng.random() < 0.12 else rng.uniform(0, 0.06))
    return 0.3 * out / np.abs(out).max()


def record(event: Array, recorder: Recorder, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return what a recorder takes of an event, which starts at 0 s of true time."""
    heard = event
    if recorder.reverb_seconds:
        heard = signal.fftconvolve(event, room_answer(recorder.reverb_seconds, rng))[: len(event)]
    count = round(recorder.seconds * recorder.rate)
    times = recorder.start + np.arange(count) / (recorder.rate * (1 + recorder.ppm * 1e-6))
    if recorder.rate < RATE:
        sos = signal.butter(10, 0.45 * recorder.rate, fs=RATE, output="sos")
        heard = signal.sosfiltfilt(sos, heard)
    fine = signal.resample_poly(heard, _UP, 1)
    out = map_coordinates(fine, [times * RATE * _UP], order=3, mode="constant")
    power = np.mean(out**2)
    noise = rng.normal(size=count)
    if rng.random() < 0.5:  # rooms rumble more than they hiss
        noise = signal.lfilter([1], [1, -0.9], noise)
    noise *= np.sqrt(power / np.mean(noise**2)) * 10 ** (-recorder.snr_db / 20)
    return (recorder.polarity * (out + noise)).astype(np.float32)


def room_answer(reverb_seconds: float, rng: np.random.Generator) -> Array:
    """Return a direct path followed by decaying noise of about equal energy."""
    count = round(reverb_seconds * RATE)
    tail = rng.normal(size=count) * 10 ** (-3 * np.arange(count) / count)
    tail[: round(0.002 * RATE)] = 0
    tail *= rng.uniform(0.5, 1.0) / np.sqrt(np.sum(tail**2))
    tail[0] = 1.0
    return tail


def true_line(first: Recorder, second: Recorder) -> tuple[float, float]:
    """Return offset [s] and drift: what the second's clock shows at a time of the first's."""
    fast_1, fast_2 = 1 + first.ppm * 1e-6, 1 + second.ppm * 1e-6
    return (first.start - second.start) * fast_2, fast_2 / fast_1 - 1


def resampled(sound: NDArray[np.float32], rate: int) -> NDArray[np.float32]:
    """Return a recording at 16 kHz by the rate its recorder believes in, as a file reader does."""
    common = np.gcd(rate, RATE)
    return signal.resample_poly(sound, RATE // common, rate // common).astype(np.float32)
