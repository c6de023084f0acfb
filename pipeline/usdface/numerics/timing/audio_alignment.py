"""Shift and clock drift between two recordings of the same sound, and their confidence.

Onsets find the shift to a hundredth of a second, phase finds it window by window to a hundredth of
a millisecond, and a robust line through the windows gives shift and drift. Each of the three can
fail, and is then reported: a wrong shift that looks right costs more than a refusal.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array
from usdface.core.progress import Progress, silent
from usdface.numerics.timing.onset_correlation import (
    OnsetCorrelation,
    PhaseVote,
    correlate_onsets,
    onset_flux,
    scan_phase,
)
from usdface.numerics.timing.window_delays import (
    RobustLine,
    WindowDelays,
    fit_robust_line,
    window_delays,
)

_LARGEST_DRIFT = 300e-6
"""Crystal clocks of recorders stay within 100 ppm of true, so two within 200 of each other."""
USUAL_DRIFT = 60e-6

LEAST_PEAK = 8.0
LEAST_RATIO = 1.15
LEAST_AGREEMENT = 0.35
LEAST_WINDOWS = 4
LEAST_LEAD = 2.0
SHORTEST_SECONDS = 1.5

_CLEAR_PEAK, _CLEAR_RATIO, _CLEAR_AGREEMENT = 16.0, 1.5, 0.8
"""At which confidence reaches 1: about twice the least."""

_SILENCE_RMS = 1e-5
"""Quieter is silence: -100 dB, less than one bit of sixteen."""

_TOLERANCE_SECONDS = 1e-3
"""By which a window may miss the line: reverberation moves the peak by less."""
_NOISE_SECONDS = 2e-5
_LONGEST_WINDOW_SECONDS, _SHORTEST_WINDOW_SECONDS = 2.0, 0.4
_WINDOWS_PER_OVERLAP = 5
_MOST_WINDOWS = 200
_SCANNED_WINDOWS = 16
_COARSE_ERROR_SECONDS = 0.03
_LOWEST_RATE_HZ = 4000


@dataclass(frozen=True)
class SoundAlignment:
    """How the clock of a second recording runs against that of a first, and the evidence.

    ``second_time = offset + (1 + drift) * first_time``
    """

    offset: float
    """[s]"""
    drift: float
    """As a share; a millionth is 1 ppm."""
    confidence: float
    """[0-1] The weakest of three signs: peak, ratio and agreement. 0.5 where one of them is at its
    limit, 1 where all are clear."""
    doubts: tuple[str, ...]
    """Why the result should not be used; empty when it should."""
    peak: float = 0.0
    """Height of the onset correlation in standard deviations of chance."""
    ratio: float = 0.0
    """How many times better than the second best shift."""
    agreement: float = 0.0
    """Share of windows within a millisecond of the line [0-1]."""
    deviation: float = 0.0
    """Root mean square distance of those from the line [s]."""
    correlation: OnsetCorrelation | None = None
    windows: WindowDelays | None = None
    agreeing: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    """(windows,)"""


def align_sounds(
    first: Float32Array,
    second: Float32Array,
    *,
    rate: int,
    names: tuple[str, str] = ("first", "second"),
    progress: Progress = silent,
) -> SoundAlignment:
    """Find when the sounds of one recording are in another.

    Parameters
    ----------
    first, second : (samples,) float32 array
        The same event by two microphones; either may start or end first.
    rate : int
        Samples per second of both, by each recorder's own clock; at least 4000.
    names : (2,) tuple of str
        What to call the recordings where something is wrong with one.

    Returns
    -------
    SoundAlignment
        With `doubts` where the recordings are silent, unrelated, repeat themselves or are too
        short.
    """
    first, second = _checked(first, names[0]), _checked(second, names[1])
    if rate < _LOWEST_RATE_HZ:
        raise ValueError(f"rate {rate} is too low to measure delays; give 16000 samples per second")
    doubts = _unusable((first, second), names, rate)
    if doubts:
        return SoundAlignment(0.0, 0.0, 0.0, doubts)
    progress(0.0, "finding onsets")
    onsets = onset_flux(first, rate=rate), onset_flux(second, rate=rate)
    progress(0.4, "correlating onsets")
    coarse = correlate_onsets(*onsets, largest_drift=_LARGEST_DRIFT)
    if coarse is None:
        return SoundAlignment(0.0, 0.0, 0.0, ("a recording holds only an unchanging sound",))
    pair = _Pair(first, second, rate)
    found = _by_onsets(coarse, pair.seconds[0] / 2)
    rivals = [coarse.rival]
    if found.doubts:
        progress(0.5, "searching by phase")
        vote = scan_phase(
            first,
            second,
            rate=rate,
            window=_window_seconds(min(pair.seconds)),
            count=_SCANNED_WINDOWS,
            largest_drift=_LARGEST_DRIFT,
        )
        by_phase = found if vote is None else _by_phase(vote)
        found = found if by_phase.doubts else by_phase
        rivals.append(np.nan if vote is None else vote.rival)
    progress(0.8, "measuring delays")
    line = _measure(pair, found, count=_MOST_WINDOWS)
    if not found.doubts:
        found = _against_rivals(pair, found, rivals)
    progress(1.0, "aligned")
    return _conclude(found, coarse, *line)


@dataclass(frozen=True)
class _Pair:
    first: Float32Array
    second: Float32Array
    rate: int

    @property
    def seconds(self) -> tuple[float, float]:
        return len(self.first) / self.rate, len(self.second) / self.rate


def _measure(pair: "_Pair", found: "_RoughShift", *, count: int) -> tuple[WindowDelays, RobustLine]:
    at_zero = found.shift - found.drift * found.middle
    overlap = min(pair.seconds[0], pair.seconds[1] - at_zero) - max(0.0, -at_zero)
    windows = window_delays(
        pair.first,
        pair.second,
        rate=pair.rate,
        window=_window_seconds(overlap),
        count=count,
        expected=(at_zero, found.drift),
        radius=(_COARSE_ERROR_SECONDS, found.drift_unknown),
    )
    if not len(windows.times):
        return windows, RobustLine(at_zero, found.drift, np.zeros(0, bool), 0.0)
    line = fit_robust_line(
        windows.times,
        windows.delays,
        tolerance=_TOLERANCE_SECONDS,
        largest_slope=_LARGEST_DRIFT,
        usual_slope=USUAL_DRIFT,
        noise=_NOISE_SECONDS,
    )
    return windows, line


def _against_rivals(pair: "_Pair", found: "_RoughShift", rivals: list[float]) -> "_RoughShift":
    """Refuse a shift if the windows agree on another too, to the millisecond."""
    for rival in rivals:
        if not np.isfinite(rival) or abs(rival - found.shift) < _COARSE_ERROR_SECONDS:
            continue
        other = replace(found, shift=rival)
        _, line = _measure(pair, other, count=_SCANNED_WINDOWS)
        agreeing = int(line.agreeing.sum())
        if agreeing >= max(LEAST_WINDOWS, LEAST_AGREEMENT * len(line.agreeing)):
            return replace(
                found,
                confidence=0.0,
                doubts=(
                    f"shifts of {found.shift:+.2f} and {rival:+.2f} s both fit to the "
                    "millisecond: the sound repeats",
                ),
            )
    return found


@dataclass(frozen=True)
class _RoughShift:
    """A shift before it is measured window by window, and its confidence."""

    shift: float
    middle: float
    drift: float
    drift_unknown: float
    confidence: float
    doubts: tuple[str, ...]


def _by_onsets(coarse: OnsetCorrelation, middle: float) -> _RoughShift:
    doubts = []
    if coarse.peak < LEAST_PEAK:
        doubts.append(
            f"the best shift stands out by {coarse.peak:.1f} deviations of chance, {LEAST_PEAK:g} "
            "are needed: the recordings seem unrelated"
        )
    elif coarse.ratio < LEAST_RATIO:
        doubts.append(
            f"shifts of {coarse.shift:+.2f} and {coarse.rival:+.2f} s explain the sound about "
            f"equally well ({coarse.ratio:.2f} times, {LEAST_RATIO:g} are needed): it repeats"
        )
    return _RoughShift(
        shift=coarse.shift,
        middle=middle,
        drift=coarse.drift,
        drift_unknown=2 * coarse.drift_step or _LARGEST_DRIFT,
        confidence=min(
            float(np.interp(coarse.peak, [0, LEAST_PEAK, _CLEAR_PEAK], [0, 0.5, 1])),
            float(np.interp(coarse.ratio, [1, LEAST_RATIO, _CLEAR_RATIO], [0, 0.5, 1])),
        ),
        doubts=tuple(doubts),
    )


def _by_phase(vote: PhaseVote) -> _RoughShift:
    share, lead = vote.votes / vote.windows, vote.votes / max(vote.rival_votes, 1)
    doubts = []
    if vote.votes < LEAST_WINDOWS or share < LEAST_AGREEMENT:
        doubts.append(
            f"{vote.votes} of {vote.windows} windows vote for one shift, {LEAST_WINDOWS} and "
            f"{LEAST_AGREEMENT:.0%} are needed: the recordings seem unrelated"
        )
    elif lead < LEAST_LEAD:
        doubts.append(
            f"{vote.votes} windows vote for a shift of {vote.shift:+.2f} s and {vote.rival_votes} "
            f"for {vote.rival:+.2f} s: the sound repeats"
        )
    return _RoughShift(
        shift=vote.shift,
        middle=vote.middle,
        drift=0.0,
        drift_unknown=_LARGEST_DRIFT,
        confidence=min(
            float(np.interp(share, [0, LEAST_AGREEMENT, _CLEAR_AGREEMENT], [0, 0.5, 1])),
            float(np.interp(lead, [1, LEAST_LEAD, 2 * LEAST_LEAD], [0, 0.5, 1])),
        ),
        doubts=tuple(doubts),
    )


def _conclude(
    found: _RoughShift, coarse: OnsetCorrelation, windows: WindowDelays, line: RobustLine
) -> SoundAlignment:
    agreeing = int(line.agreeing.sum())
    agreement = agreeing / max(len(line.agreeing), 1)
    doubts = found.doubts
    if agreement < LEAST_AGREEMENT or agreeing < LEAST_WINDOWS:
        doubts += (
            f"{agreeing} of {len(line.agreeing)} windows agree on one shift and drift, "
            f"{LEAST_WINDOWS} and {LEAST_AGREEMENT:.0%} are needed",
        )
    sign = float(np.interp(agreement, [0, LEAST_AGREEMENT, _CLEAR_AGREEMENT], [0, 0.5, 1]))
    return SoundAlignment(
        offset=line.intercept,
        drift=line.slope,
        confidence=min(found.confidence, sign),
        doubts=doubts,
        peak=coarse.peak,
        ratio=coarse.ratio,
        agreement=agreement,
        deviation=line.deviation,
        correlation=coarse,
        windows=windows,
        agreeing=line.agreeing,
    )


def _window_seconds(overlap: float) -> float:
    return float(
        np.clip(overlap / _WINDOWS_PER_OVERLAP, _SHORTEST_WINDOW_SECONDS, _LONGEST_WINDOW_SECONDS)
    )


def _unusable(
    sounds: tuple[Float32Array, Float32Array], names: tuple[str, str], rate: int
) -> tuple[str, ...]:
    doubts = []
    for name, sound in zip(names, sounds, strict=True):
        if len(sound) < SHORTEST_SECONDS * rate:
            doubts.append(
                f"the {name} recording lasts {len(sound) / rate:.2f} s, {SHORTEST_SECONDS:g} s are "
                "needed"
            )
        elif float(np.sqrt(np.mean(sound**2))) < _SILENCE_RMS:
            doubts.append(f"the {name} recording is silent")
    return tuple(doubts)


def _checked(sound: Float32Array, name: str) -> Float32Array:
    samples = np.ascontiguousarray(sound, dtype=np.float32)
    if samples.ndim != 1:
        raise ValueError(f"the {name} recording has shape {samples.shape}; give one row of samples")
    if not np.isfinite(samples).all():
        raise ValueError(f"the {name} recording holds NaN or infinite samples; export it again")
    return samples
