"""Alignment of sound: fifty simulated pairs of recordings, and pairs that must be refused.

Recorded speech with reverberation is recorded by two devices whose clocks differ by up to
120 ppm, at usual sample rates and signal-to-noise ratios of 0 to 20 dB (camera) and 15 to 40 dB
(capture). Errors are the largest over the camera's recording.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from tests.conftest import SHARED_DATA
from tests.numerics.simulated_sound import RATE, Recorder, record, resampled, true_line
from usdface.media.film.sound import read_audio
from usdface.numerics.timing.audio_alignment import SoundAlignment, align_sounds

PAIRS = 50
REFUSALS = 20
RATES = (16000, 22050, 32000, 44100, 48000)
SPEECH = SHARED_DATA / "speech_mfa" / "wav"
RECORDINGS = ("acoustic_corpus.wav", "cold_corpus.wav", "cold_corpus3.wav")

Sound = np.ndarray
Pair = tuple[Sound, Sound]


@dataclass(frozen=True)
class Trial:
    """Result and truth of one pair."""

    found: SoundAlignment
    error_ms: float
    drift_error_ppm: float


def run() -> None:
    """Print accuracy by length, and refusals by kind."""
    if not SPEECH.is_dir():
        print(f"skipped: the recordings are not at {SPEECH}")
        return
    speech = [read_audio(SPEECH / name, rate=RATE).astype(np.float64) for name in RECORDINGS]
    print(f"{'camera':>10} {'pairs':>6} {'right':>6} {'refused':>8} {'wrong':>6}", end=" ")
    print(f"{'median ms':>10} {'worst ms':>9} {'median ppm':>11} {'s a pair':>9}")
    for label, lengths, both_noisy in (
        ("8-22 s", (8.0, 22.0), False),
        ("3-5 s", (3.0, 5.0), False),
        ("8-22 s *", (8.0, 22.0), True),
    ):
        start = time.perf_counter()
        trials = list(simulate_pairs(speech, lengths, both_noisy=both_noisy))
        _print_trials(label, trials, (time.perf_counter() - start) / len(trials))
    print("* both recordings with noise of 0 to 20 dB\n")
    print(f"{'must be refused':>26} {'refused':>8} {'highest confidence':>19}")
    for label, make in unusable_pairs(speech).items():
        rng = np.random.default_rng(0)
        found = [_aligned(make(rng)) for _ in range(REFUSALS)]
        refused = sum(bool(each.warnings) for each in found)
        highest = max(each.confidence for each in found)
        print(f"{label:>26} {refused:>4} / {REFUSALS} {highest:>18.2f}")


def _aligned(sounds: Iterable[Sound]) -> SoundAlignment:
    first, second = (each.astype(np.float32) for each in sounds)
    return align_sounds(first, second, rate=RATE)


def simulate_pairs(
    speech: list[Sound], lengths: tuple[float, float], *, both_noisy: bool
) -> Iterator[Trial]:
    """Yield trials on pairs of recordings of one event."""
    rng = np.random.default_rng(0)
    for index in range(PAIRS):
        event = speech[index % len(speech)]
        total = len(event) / RATE
        seconds = rng.uniform(*lengths)
        fast = rng.uniform(-60, 60, 2)
        camera = Recorder(
            start=rng.uniform(0.0, total - seconds),
            seconds=seconds,
            rate=int(rng.choice(RATES)),
            ppm=fast[0],
            snr_db=rng.uniform(0, 20),
            reverb_seconds=float(rng.choice([0.0, 0.2, 0.4, 0.6])),
            polarity=int(rng.choice([-1, 1])),
        )
        capture = Recorder(
            start=rng.uniform(-2.0, 1.0),
            seconds=total - 1.0,
            rate=int(rng.choice(RATES)),
            ppm=fast[1],
            snr_db=rng.uniform(0, 20) if both_noisy else rng.uniform(15, 40),
            reverb_seconds=float(rng.choice([0.0, 0.2])),
        )
        sounds = [resampled(record(event, each, rng), each.rate) for each in (camera, capture)]
        found = _aligned(sounds)
        offset, drift = true_line(camera, capture)
        times = np.array([0.0, seconds])
        error = np.abs(found.offset - offset + (found.drift - drift) * times).max()
        yield Trial(found, 1e3 * float(error), 1e6 * abs(found.drift - drift))


def unusable_pairs(speech: list[Sound]) -> dict[str, Callable[[np.random.Generator], Pair]]:
    """Return functions that make pairs without a valid alignment, by kind."""

    def heard(event: Sound, rng: np.random.Generator, shortest: float = 4.0) -> Sound:
        total = len(event) / RATE
        seconds = rng.uniform(min(shortest, total), min(20.0, total))
        recorder = Recorder(
            start=rng.uniform(0, max(total - seconds, 0.01)),
            seconds=seconds,
            ppm=rng.uniform(-60, 60),
            snr_db=rng.uniform(0, 40),
            reverb_seconds=float(rng.choice([0.0, 0.3])),
        )
        return record(event, recorder, rng)

    def two(rng: np.random.Generator) -> Pair:
        first, second = rng.permutation(len(speech))[:2]
        return speech[first], speech[second]

    def other_words(rng: np.random.Generator) -> Pair:
        first, second = two(rng)
        return heard(first, rng), heard(second, rng)

    def other_part(rng: np.random.Generator) -> Pair:
        event, half = two(rng)[0], 12 * RATE
        return heard(event[:half], rng), heard(event[half + RATE :], rng)

    def same_hum(rng: np.random.Generator) -> Pair:
        first, second = other_words(rng)
        times = np.arange(40 * RATE) / RATE
        tones = (np.sin(2 * np.pi * 50 * k * times + k * k) / k for k in range(1, 30))
        hum = sum(tones, np.zeros(len(times))) * 0.05
        return first + hum[: len(first)], second + hum[5000 : 5000 + len(second)]

    def loop(period: float) -> Callable[[np.random.Generator], Pair]:
        def make(rng: np.random.Generator) -> Pair:
            event = two(rng)[0]
            start = int(rng.uniform(0, len(event) / RATE - period) * RATE)
            repeated = np.tile(event[start : start + int(period * RATE)], int(24 / period) + 1)
            return heard(repeated, rng, 1.6 * period), heard(repeated, rng, 1.6 * period)

        return make

    def silent(rng: np.random.Generator) -> Pair:
        return np.zeros(9 * RATE), heard(two(rng)[0], rng)

    def noise(rng: np.random.Generator) -> Pair:
        return rng.normal(size=9 * RATE) * 0.1, heard(two(rng)[0], rng)

    def faint_noise(rng: np.random.Generator) -> Pair:
        return rng.normal(size=9 * RATE) * 1e-4, rng.normal(size=9 * RATE) * 1e-4

    return {
        "other words": other_words,
        "another part": other_part,
        "other words, the same hum": same_hum,
        "a loop of 1.5 s": loop(1.5),
        "a loop of 3 s": loop(3.0),
        "a loop of 6 s": loop(6.0),
        "a loop of 10 s": loop(10.0),
        "silence": silent,
        "noise": noise,
        "two empty rooms": faint_noise,
    }


def _print_trials(label: str, trials: list[Trial], seconds: float) -> None:
    right = [each for each in trials if not each.found.warnings and each.error_ms < 1]
    refused = sum(bool(each.found.warnings) for each in trials)
    errors = [each.error_ms for each in right]
    drifts = [each.drift_error_ppm for each in right]
    print(
        f"{label:>10} {len(trials):>6} {len(right):>6} {refused:>8} "
        f"{len(trials) - len(right) - refused:>6} {np.median(errors):>10.4f} {max(errors):>9.3f} "
        f"{np.median(drifts):>11.2f} {seconds:>9.2f}"
    )


if __name__ == "__main__":
    run()
