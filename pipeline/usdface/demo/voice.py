"""Synthetic voice of the script: a pulsed source with formants.

It has the rhythm, pitch, fricatives, closures and silences of a recording, but is not intelligible.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import Float32Array, FloatArray, smoothstep
from usdface.demo.script import DURATION_SECONDS, GLIDES, TimedPhone, timed_phones

_WINDOW_SAMPLES = 1024  # length of a spectral frame, with an overlap of one half
_ROOM_LEVEL = 10.0 ** (-62.0 / 20.0)  # background noise, -62 dB

# First three formants of an adult's vowels and voiced sounds [Hz].
_FORMANTS: Mapping[str, tuple[int, int, int]] = {
    "AA": (710, 1150, 2500),
    "AE": (660, 1720, 2420),
    "AH": (620, 1220, 2550),
    "AO": (570, 860, 2450),
    "AW": (700, 1150, 2500),
    "AY": (700, 1200, 2500),
    "EH": (530, 1840, 2500),
    "ER": (490, 1350, 1700),
    "EY": (480, 2000, 2600),
    "IH": (400, 1980, 2550),
    "IY": (290, 2250, 2950),
    "OW": (520, 950, 2450),
    "UH": (450, 1050, 2300),
    "UW": (320, 880, 2250),
    "M": (260, 1100, 2200),
    "N": (270, 1600, 2400),
    "NG": (270, 2000, 2600),
    "L": (360, 1250, 2600),
    "R": (340, 1150, 1600),
    "W": (310, 720, 2250),
    "Y": (280, 2200, 2950),
    "V": (300, 1300, 2300),
    "Z": (300, 1600, 2500),
    "DH": (300, 1400, 2500),
}
_DEFAULT = (450, 1500, 2500)
_GLIDE_PHONES = {"UU": "UW", "IY": "IY"}
# Band [Hz] and level of fricatives.
_HISS: Mapping[str, tuple[float, float, float]] = {
    "S": (4500, 9000, 0.30),
    "Z": (4500, 9000, 0.16),
    "F": (1800, 9500, 0.11),
    "V": (1800, 8500, 0.05),
    "TH": (2500, 8500, 0.08),
    "DH": (2500, 8000, 0.03),
    "HH": (600, 3500, 0.10),
}
_BURST: Mapping[str, tuple[float, float]] = {
    "P": (300, 2500),
    "B": (300, 2000),
    "T": (2800, 8000),
    "D": (2300, 6500),
    "K": (1400, 4200),
    "G": (1200, 3600),
}
_NASAL_LEVEL = 0.45
_PITCH = {"neutral": 118.0, "happiness": 158.0, "anger": 142.0, "sadness": 104.0}
_LOUD = {"neutral": 0.8, "happiness": 1.0, "anger": 1.15, "sadness": 0.6}


def speak(sample_rate: int) -> Float32Array:
    """Return the sound of the script, mono, as long as the performance: (samples,) [-1 to 1]."""
    count = round(DURATION_SECONDS * sample_rate)
    time = np.arange(count) / sample_rate
    rng = np.random.default_rng(440)
    phones = timed_phones()
    pitch, voicing = _melody(time, phones)
    phase = np.cumsum(pitch) / sample_rate
    # Rounded pulses with harmonics that fall by about 12 dB per octave, like vocal folds.
    pulse = np.maximum(np.sin(2.0 * np.pi * phase), 0.0) ** 6
    source = (pulse - 0.2) * voicing + 0.02 * rng.standard_normal(count) * voicing
    voiced = _shaped(source, phones, sample_rate)
    sound = voiced / max(float(np.abs(voiced).max()), 1e-9)
    noise = rng.standard_normal(count)
    spectrum = np.fft.rfft(noise)
    frequency = np.asarray(np.fft.rfftfreq(count, 1.0 / sample_rate), np.float64)
    for phone, (low, high, strength) in _HISS.items():
        matching = [p for p in phones if p.phone == phone]
        sound += (
            strength * _band(spectrum, frequency, low, high, count) * _gate(time, matching, 0.018)
        )
    for phone, (low, high) in _BURST.items():
        bursts = [
            TimedPhone(phone, p.stop - 0.018, p.stop + 0.012, p.emotion)
            for p in phones
            if p.phone == phone
        ]
        sound += 0.16 * _band(spectrum, frequency, low, high, count) * _gate(time, bursts, 0.006)
    sound = 0.55 * sound + _ROOM_LEVEL * _band(spectrum, frequency, 60.0, 3000.0, count)
    return np.asarray(np.clip(sound, -0.98, 0.98), np.float32)


def _melody(time: FloatArray, phones: tuple[TimedPhone, ...]) -> tuple[FloatArray, FloatArray]:
    """Return pitch [Hz] and level of the voice over time."""
    pitch = np.full_like(time, 115.0)
    voicing = np.zeros_like(time)
    for emotion, base in _PITCH.items():
        matching = [p for p in phones if p.emotion == emotion]
        start, stop = matching[0].start, matching[-1].stop
        inside = (time > start - 0.2) & (time < stop + 0.2)
        along = np.clip((time - start) / (stop - start), 0.0, 1.0)
        tune = base * (1.12 - 0.26 * along + 0.06 * np.sin(2.0 * np.pi * 1.7 * (time - start)))
        pitch = np.where(inside, tune, pitch)
        spoken = [p for p in matching if p.phone in _FORMANTS]
        nasal = [p for p in spoken if p.phone in ("M", "N", "NG", "V", "Z", "DH")]
        clear = [p for p in spoken if p not in nasal]
        voicing += _LOUD[emotion] * np.maximum(
            _gate(time, clear, 0.022), _NASAL_LEVEL * _gate(time, nasal, 0.018)
        )
    return pitch, voicing


def _gate(time: FloatArray, phones: list[TimedPhone], ramp: float) -> FloatArray:
    """Return 1 during the sounds, with soft ends, else 0."""
    gate = np.zeros_like(time)
    for p in phones:
        first, last = np.searchsorted(time, [p.start - ramp, p.stop + ramp])
        t = time[first:last]
        shape = smoothstep(t, p.start - ramp, p.start + ramp) * smoothstep(
            t, p.stop + ramp, p.stop - ramp
        )
        gate[first:last] = np.maximum(gate[first:last], shape)
    return gate


def _shaped(source: FloatArray, phones: tuple[TimedPhone, ...], sample_rate: int) -> FloatArray:
    """Return the source filtered by the formants over time, with overlapping windows."""
    knots, values = [0.0], [_DEFAULT]
    for p in phones:
        formants = _FORMANTS.get(p.phone)
        if formants is None:
            continue
        length = p.stop - p.start
        knots += [p.start + 0.25 * length, p.stop - 0.25 * length]
        glide = GLIDES.get(p.phone)
        values += [formants, _FORMANTS[_GLIDE_PHONES[glide]] if glide else formants]
    table = np.array(values, float)
    hop = _WINDOW_SAMPLES // 2
    window = np.hanning(_WINDOW_SAMPLES + 1)[:-1]
    padded = np.pad(source, (hop, 2 * _WINDOW_SAMPLES))
    starts = np.arange(0, len(source) + hop, hop)
    middles = starts / sample_rate
    formants_at = np.stack([np.interp(middles, knots, column) for column in table.T], axis=1)
    frames = padded[starts[:, None] + np.arange(_WINDOW_SAMPLES)] * window
    frequency = np.fft.rfftfreq(2 * _WINDOW_SAMPLES, 1.0 / sample_rate)
    gain = np.zeros((len(starts), len(frequency)))
    for number, (bandwidth, level) in enumerate(((80.0, 1.0), (110.0, 0.55), (170.0, 0.25))):
        distance = frequency - formants_at[:, number : number + 1]
        gain += level / (1.0 + (distance / bandwidth) ** 2)
    shaped = np.fft.irfft(np.fft.rfft(frames, 2 * _WINDOW_SAMPLES) * gain, 2 * _WINDOW_SAMPLES)
    out = np.zeros(len(padded) + 2 * _WINDOW_SAMPLES)
    for start, frame in zip(starts, shaped, strict=True):
        out[start : start + 2 * _WINDOW_SAMPLES] += frame
    return out[hop : hop + len(source)]


def _band(
    spectrum: NDArray[np.complex128], frequency: FloatArray, low: float, high: float, count: int
) -> FloatArray:
    """Return normalised noise between two frequencies [Hz]."""
    edge = smoothstep(frequency, 0.8 * low, low) * smoothstep(frequency, 1.15 * high, high)
    band = np.fft.irfft(spectrum * edge, count)
    return np.asarray(band / max(float(np.std(band)) * 3.0, 1e-9))
