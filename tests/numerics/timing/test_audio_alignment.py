"""Two recordings of one event are laid on each other to a hundredth of a frame, or refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.numerics.simulated_sound import RATE, Recorder, record, resampled, speech, true_line
from usdface.numerics.timing.audio_alignment import align_sounds
from usdface.numerics.timing.onset_correlation import (
    HOPS_PER_SECOND,
    correlate_onsets,
    onset_flux,
    scan_phase,
)
from usdface.numerics.timing.window_delays import fit_robust_line, window_delays

MILLISECOND = 1e-3
CAPTURE = Recorder(start=0.3, seconds=17.0, ppm=40, snr_db=30)
CAMERA = Recorder(start=2.1, seconds=13.0, ppm=-60, snr_db=10, reverb_seconds=0.3)


@pytest.fixture(scope="module")
def event() -> np.ndarray:
    return speech(18.0, np.random.default_rng(0))


def pair(event: np.ndarray, camera: Recorder, capture: Recorder, seed: int = 0):
    rng = np.random.default_rng(seed)
    sounds = [resampled(record(event, each, rng), each.rate) for each in (camera, capture)]
    return align_sounds(*sounds, rate=RATE)


def worst_error(found, camera: Recorder, capture: Recorder) -> float:
    """Largest error of the line over the first recording [s]."""
    offset, drift = true_line(camera, capture)
    times = np.array([0, camera.seconds])
    return float(np.abs(found.offset - offset + (found.drift - drift) * times).max())


@pytest.mark.parametrize(
    ("camera", "capture"),
    [
        ({}, {}),
        ({"rate": 44100}, {"rate": 48000}),
        ({"ppm": -120}, {"ppm": 0}),
        ({"ppm": 60}, {"ppm": -60}),
        ({"snr_db": 0}, {}),
        ({"snr_db": 3}, {"snr_db": 3}),
        ({"reverb_seconds": 0.6, "snr_db": 5}, {"reverb_seconds": 0.2}),
        ({"polarity": -1}, {}),
        ({"start": -2.0, "seconds": 19.0}, {"start": 4.0, "seconds": 9.0}),
        ({"start": 6.0, "seconds": 3.0}, {}),
    ],
    ids=lambda changes: ",".join(f"{name}={value}" for name, value in changes.items()) or "usual",
)
def test_shift_and_drift_are_found_within_a_millisecond(event, camera, capture) -> None:
    camera, capture = replace(CAMERA, **camera), replace(CAPTURE, **capture)
    found = pair(event, camera, capture)
    assert found.warnings == ()
    assert found.confidence >= 0.5
    assert worst_error(found, camera, capture) < 0.1 * MILLISECOND


def test_exchanged_recordings_give_the_inverse_line(event) -> None:
    forth, back = pair(event, CAMERA, CAPTURE), pair(event, CAPTURE, CAMERA)
    times = np.array([0.0, CAMERA.seconds])
    there = forth.offset + (1 + forth.drift) * times
    again = back.offset + (1 + back.drift) * there
    np.testing.assert_allclose(again, times, atol=0.05 * MILLISECOND)


def test_loudness_changes_nothing_and_silence_before_moves_the_shift_by_itself(event) -> None:
    rng = np.random.default_rng(0)
    first, second = record(event, CAMERA, rng), record(event, CAPTURE, rng)
    plain = align_sounds(first, second, rate=RATE)
    quiet = align_sounds(0.01 * first, second, rate=RATE)
    later = align_sounds(first, np.concatenate([np.zeros(2 * RATE, np.float32), second]), rate=RATE)
    assert quiet.offset == pytest.approx(plain.offset, abs=1e-6)
    assert later.offset - 2 == pytest.approx(plain.offset, abs=0.02 * MILLISECOND)


def test_windows_vote_by_phase_where_noise_drowns_the_onsets(event) -> None:
    rng = np.random.default_rng(2)
    first = record(event, replace(CAMERA, snr_db=0), rng)
    second = record(event, replace(CAPTURE, snr_db=5), rng)
    vote = scan_phase(first, second, rate=RATE, window=2.0, count=12, largest_drift=3e-4)
    offset, drift = true_line(CAMERA, CAPTURE)
    assert vote.votes >= 4
    assert vote.votes >= 2 * vote.rival_votes
    assert vote.shift == pytest.approx(offset + drift * vote.middle, abs=2 * MILLISECOND)


def tone(seconds: float) -> np.ndarray:
    time = np.arange(round(seconds * RATE)) / RATE
    return sum(np.sin(2 * np.pi * 50 * k * time + k * k) / k for k in range(1, 30)) * 0.05


def looped(event: np.ndarray, period: float) -> np.ndarray:
    return np.tile(event[2 * RATE : round((2 + period) * RATE)], int(20 / period) + 1)


def unrelated(seed: int):
    rng = np.random.default_rng(seed)
    return tuple(record(speech(12, rng), Recorder(0.0, 11.0, snr_db=30), rng) for _ in range(2))


def noises(seed: int):
    rng = np.random.default_rng(seed)
    return rng.normal(size=8 * RATE) * 0.1, rng.normal(size=12 * RATE) * 0.1


def loops(event: np.ndarray, period: float, seed: int):
    rng = np.random.default_rng(seed)
    sound = looped(event, period)
    starts = rng.uniform(0, 3, 2)
    return tuple(
        record(sound, Recorder(start, seconds, ppm=ppm, snr_db=20), rng)
        for start, seconds, ppm in zip(starts, (12, 16), (30, -30), strict=True)
    )


REFUSED = {
    "other words": (lambda _: unrelated(1), "seem unrelated"),
    "other words again": (lambda _: unrelated(2), "seem unrelated"),
    "noise": (lambda _: noises(1), "seem unrelated"),
    "a loop of 1.5 s": (lambda event: loops(event, 1.5, 0), "repeats"),
    "a loop of 4 s": (lambda event: loops(event, 4.0, 1), "repeats"),
    "a loop of 9 s": (lambda event: loops(event, 9.0, 2), "repeats"),
    "the same file, looped": (lambda event: (looped(event, 6),) * 2, "repeats"),
    "hum": (lambda _: (tone(9), tone(12)), ""),
    "silence": (lambda event: (np.zeros(9 * RATE), event), "the first recording is silent"),
    "the other silent": (lambda event: (event, event * 1e-6), "the second recording is silent"),
    "too short": (lambda event: (event[:RATE], event), "lasts 1.00 s, 1.5 s are needed"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_aligned_is_refused_with_the_reason(event, name: str) -> None:
    make, reason = REFUSED[name]
    found = align_sounds(*make(event), rate=RATE)
    assert found.warnings
    assert reason in "; ".join(found.warnings)
    assert found.confidence < 0.5


def test_onsets_of_long_recordings_are_found_in_spite_of_the_drift() -> None:
    rng = np.random.default_rng(0)
    hops = 20 * 60 * HOPS_PER_SECOND  # the drift moves them by thirty hops
    first = rng.normal(size=(4, hops)).astype(np.float32)
    index = np.round((np.arange(hops) - 4000) / (1 + 250e-6)).astype(int)
    inside = (index >= 0) & (index < hops)
    second = np.where(inside, first[:, index.clip(0, hops - 1)], 0)
    second += rng.normal(size=second.shape).astype(np.float32)
    found = correlate_onsets(first, second, largest_drift=300e-6)
    assert found.drift == pytest.approx(250e-6, abs=2 * found.drift_step)
    assert found.shift == pytest.approx(40 + 250e-6 * 600, abs=0.03)
    assert found.peak > 50


def test_an_onset_is_where_the_sound_begins() -> None:
    sound = np.zeros(2 * RATE, np.float32)
    sound[RATE:] = np.random.default_rng(0).normal(size=RATE)
    flux = onset_flux(sound, rate=RATE).sum(axis=0)
    assert abs(int(np.argmax(flux)) - HOPS_PER_SECOND) <= 3


def test_a_line_is_found_though_half_the_points_are_wrong() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(40.0)
    y = 3.0 + 1e-4 * x + rng.normal(0, 1e-5, 40)
    wrong = rng.permutation(40)[:20]
    y[wrong] += rng.uniform(-0.03, 0.03, 20)
    line = fit_robust_line(x, y, tolerance=1e-3, largest_slope=3e-4, usual_slope=6e-5, noise=1e-5)
    assert line.slope == pytest.approx(1e-4, abs=1e-6)
    assert line.intercept == pytest.approx(3.0, abs=3e-5)
    right = np.setdiff1d(np.arange(40), wrong)
    assert line.agreeing[right].all()


def test_a_line_through_right_points_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 100, 60))
    y = 1.0 - 2e-4 * x + rng.uniform(-1e-5, 1e-5, 60)
    line = fit_robust_line(x, y, tolerance=1e-3, largest_slope=3e-4, usual_slope=1, noise=1e-5)
    slope, intercept = np.polyfit(x, y, 1)
    assert line.slope == pytest.approx(slope, rel=1e-6)
    assert line.intercept == pytest.approx(intercept, rel=1e-9)


def test_few_near_points_do_not_make_up_a_drift() -> None:
    x = np.array([0.0, 0.4, 0.8])
    y = np.array([0.0, 0.5e-4, 1.0e-4])  # 125 ppm, of noise
    line = fit_robust_line(x, y, tolerance=1e-3, largest_slope=3e-4, usual_slope=6e-5, noise=1e-4)
    assert abs(line.slope) < 2e-5


def test_windows_before_the_other_recording_have_no_delay() -> None:
    noise = np.random.default_rng(0).normal(0, 0.1, 40_000).astype(np.float32)
    found = window_delays(
        noise,
        noise,
        rate=RATE,
        window=0.4,
        count=8,
        expected=(-0.1, -3.0),  # clocks so different that windows end before the other begins
        radius=(0.03, 0.0),
    )
    assert len(found.times) < 8
