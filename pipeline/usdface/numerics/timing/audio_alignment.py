"""Shift and clock drift between two recordings of the same sound, and their confidence.

Correlation of onsets gives the shift to 10 ms, phase correlation gives the delays of windows to
0.01 ms, and a robust line through these shift and drift. Failures of each are reported.
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
"""Crystal clocks of recorders are accurate to 100 ppm, so two differ by up to 200 ppm."""
USUAL_DRIFT = 60e-6
"""Standard deviation of the prior of the drift; most pairs of recorders differ by less."""

LEAST_PEAK = 8.0
"""[standard deviations] Least height of the onset correlation; see `SoundAlignment.peak`."""
LEAST_RATIO = 1.15
"""Least `OnsetCorrelation.ratio`: below it, another shift fits as well."""
LEAST_AGREEMENT = 0.35
LEAST_WINDOWS = 4
"""Least share and number of windows that agree on a shift."""
LEAST_LEAD = 2.0
"""Least ratio of the votes for a shift to those for the next one."""
SHORTEST_SECONDS = 1.5
"""Least length of a recording: six of the shortest windows, which overlap by half."""

_CLEAR_PEAK, _CLEAR_RATIO, _CLEAR_AGREEMENT = 16.0, 1.5, 0.8
"""At which the confidence is 1: about twice the least."""

_SILENCE_RMS = 1e-5
"""-100 dB, less than one bit of sixteen."""

_TOLERANCE_SECONDS = 1e-3
"""Largest distance of a window from the line; shifts of the peak by reverberation are smaller."""
_NOISE_SECONDS = 2e-5
"""Least standard deviation of a window's delay: about one sample at 48 kHz."""
_LONGEST_WINDOW_SECONDS, _SHORTEST_WINDOW_SECONDS = 2.0, 0.4
_WINDOWS_PER_OVERLAP = 5
"""Windows last a fifth of the recordings' overlap, within these limits."""
_MOST_WINDOWS = 200
_SCANNED_WINDOWS = 16
"""Largest number of windows of the line, and of a search for a shift."""
_COARSE_ERROR_SECONDS = 0.03
"""Largest error of the shift by onsets, three of their frames: windows are searched within it."""


@dataclass(frozen=True)
class SoundAlignment:
    """Clock of a second recording against that of a first, and the evidence.

    ``second_time = offset + (1 + drift) * first_time``
    """

    offset: float
    """[s]"""
    drift: float
    """As a share; a millionth is 1 ppm."""
    confidence: float
    """[0-1] The least of three criteria: peak, ratio (of a shift by phase, share and lead of its
    votes) and agreement. 0.5 if one of them is at its limit, 1 if all are clear."""
    warnings: tuple[str, ...]
    """Reasons not to use the result."""
    peak: float = 0.0
    """Height of the onset correlation in standard deviations of random ones."""
    ratio: float = 0.0
    """See `OnsetCorrelation.ratio`."""
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
    """Measure shift and clock drift between two recordings of the same event.

    The result has `warnings` if the recordings are silent, unrelated, periodic or too short.

    Parameters
    ----------
    first, second : (samples,) float32 array
        Either may start or end first.
    rate : int
        Nominal samples per second of both; at least 4000, for the spectrum of speech.
    names : (2,) tuple of str
        Of the recordings, for messages.
    """
    warnings = _unusable((first, second), names, rate)
    if warnings:
        return SoundAlignment(0.0, 0.0, 0.0, warnings)
    progress(0.0, "finding onsets")
    onsets = onset_flux(first, rate=rate), onset_flux(second, rate=rate)
    progress(0.4, "correlating onsets")
    coarse = correlate_onsets(*onsets, largest_drift=_LARGEST_DRIFT)
    if coarse is None:
        return SoundAlignment(0.0, 0.0, 0.0, ("a recording holds only an unchanging sound",))
    pair = _Pair(first, second, rate)
    rough = _by_onsets(coarse, pair.seconds[0] / 2)
    rivals = [coarse.rival]
    if rough.warnings:
        progress(0.5, "searching by phase")
        vote = scan_phase(
            first,
            second,
            rate=rate,
            window=_window_seconds(min(pair.seconds)),
            count=_SCANNED_WINDOWS,
            largest_drift=_LARGEST_DRIFT,
        )
        by_phase = rough if vote is None else _by_phase(vote)
        rough = rough if by_phase.warnings else by_phase
        rivals.append(np.nan if vote is None else vote.rival)
    progress(0.8, "measuring delays")
    line = _measure(pair, rough, count=_MOST_WINDOWS)
    if not rough.warnings:
        rough = _against_rivals(pair, rough, rivals)
    progress(1.0, "aligned")
    return _conclude(rough, coarse, *line)


@dataclass(frozen=True)
class _Pair:
    first: Float32Array
    second: Float32Array
    rate: int

    @property
    def seconds(self) -> tuple[float, float]:
        return len(self.first) / self.rate, len(self.second) / self.rate


def _measure(pair: "_Pair", rough: "_RoughShift", *, count: int) -> tuple[WindowDelays, RobustLine]:
    at_zero = rough.shift - rough.drift * rough.middle
    overlap = min(pair.seconds[0], pair.seconds[1] - at_zero) - max(0.0, -at_zero)
    windows = window_delays(
        pair.first,
        pair.second,
        rate=pair.rate,
        window=_window_seconds(overlap),
        count=count,
        expected=(at_zero, rough.drift),
        radius=(_COARSE_ERROR_SECONDS, rough.drift_unknown),
    )
    if not len(windows.times):
        return windows, RobustLine(at_zero, rough.drift, np.zeros(0, bool), 0.0)
    line = fit_robust_line(
        windows.times,
        windows.delays,
        tolerance=_TOLERANCE_SECONDS,
        largest_slope=_LARGEST_DRIFT,
        usual_slope=USUAL_DRIFT,
        noise=_NOISE_SECONDS,
    )
    return windows, line


def _against_rivals(pair: "_Pair", rough: "_RoughShift", rivals: list[float]) -> "_RoughShift":
    """Refuse a shift if the windows agree on another too, to the millisecond."""
    for rival in rivals:
        if not np.isfinite(rival) or abs(rival - rough.shift) < _COARSE_ERROR_SECONDS:
            continue
        other = replace(rough, shift=rival)
        _, line = _measure(pair, other, count=_SCANNED_WINDOWS)
        agreeing = int(line.agreeing.sum())
        if agreeing >= max(LEAST_WINDOWS, LEAST_AGREEMENT * len(line.agreeing)):
            return replace(
                rough,
                confidence=0.0,
                warnings=(
                    f"shifts of {rough.shift:+.2f} and {rival:+.2f} s both fit to the "
                    "millisecond: the sound repeats",
                ),
            )
    return rough


@dataclass(frozen=True)
class _RoughShift:
    """A shift before it is measured window by window, and its confidence."""

    shift: float
    middle: float
    drift: float
    drift_unknown: float
    confidence: float
    warnings: tuple[str, ...]


def _by_onsets(coarse: OnsetCorrelation, middle: float) -> _RoughShift:
    warnings = []
    if coarse.peak < LEAST_PEAK:
        warnings.append(
            f"the best shift stands out by {coarse.peak:.1f} deviations of chance, {LEAST_PEAK:g} "
            "are needed: the recordings seem unrelated"
        )
    elif coarse.ratio < LEAST_RATIO:
        warnings.append(
            f"shifts of {coarse.shift:+.2f} and {coarse.rival:+.2f} s explain the sound about "
            f"equally well ({coarse.ratio:.2f} times, {LEAST_RATIO:g} are needed): it repeats"
        )
    return _RoughShift(
        shift=coarse.shift,
        middle=middle,
        drift=coarse.drift,
        drift_unknown=2 * coarse.drift_step or _LARGEST_DRIFT,
        confidence=min(
            _grade(coarse.peak, 0, LEAST_PEAK, _CLEAR_PEAK),
            _grade(coarse.ratio, 1, LEAST_RATIO, _CLEAR_RATIO),
        ),
        warnings=tuple(warnings),
    )


def _by_phase(vote: PhaseVote) -> _RoughShift:
    share, lead = vote.votes / vote.windows, vote.votes / max(vote.rival_votes, 1)
    warnings = []
    if vote.votes < LEAST_WINDOWS or share < LEAST_AGREEMENT:
        warnings.append(
            f"{vote.votes} of {vote.windows} windows vote for one shift, {LEAST_WINDOWS} and "
            f"{LEAST_AGREEMENT:.0%} are needed: the recordings seem unrelated"
        )
    elif lead < LEAST_LEAD:
        warnings.append(
            f"{vote.votes} windows vote for a shift of {vote.shift:+.2f} s and {vote.rival_votes} "
            f"for {vote.rival:+.2f} s: the sound repeats"
        )
    return _RoughShift(
        shift=vote.shift,
        middle=vote.middle,
        drift=0.0,
        drift_unknown=_LARGEST_DRIFT,
        confidence=min(
            _grade(share, 0, LEAST_AGREEMENT, _CLEAR_AGREEMENT),
            _grade(lead, 1, LEAST_LEAD, 2 * LEAST_LEAD),
        ),
        warnings=tuple(warnings),
    )


def _conclude(
    rough: _RoughShift, coarse: OnsetCorrelation, windows: WindowDelays, line: RobustLine
) -> SoundAlignment:
    agreeing = int(line.agreeing.sum())
    agreement = agreeing / max(len(line.agreeing), 1)
    warnings = rough.warnings
    if agreement < LEAST_AGREEMENT or agreeing < LEAST_WINDOWS:
        warnings += (
            f"{agreeing} of {len(line.agreeing)} windows agree on one shift and drift, "
            f"{LEAST_WINDOWS} and {LEAST_AGREEMENT:.0%} are needed",
        )
    by_lines = _grade(agreement, 0, LEAST_AGREEMENT, _CLEAR_AGREEMENT)
    return SoundAlignment(
        offset=line.intercept,
        drift=line.slope,
        confidence=min(rough.confidence, by_lines),
        warnings=warnings,
        peak=coarse.peak,
        ratio=coarse.ratio,
        agreement=agreement,
        deviation=line.deviation,
        correlation=coarse,
        windows=windows,
        agreeing=line.agreeing,
    )


def _grade(value: float, chance: float, least: float, clear: float) -> float:
    """Return the confidence by one criterion: 0 by chance, 0.5 at its limit, 1 if clear."""
    return float(np.interp(value, [chance, least, clear], [0.0, 0.5, 1.0]))


def _window_seconds(overlap: float) -> float:
    return float(
        np.clip(overlap / _WINDOWS_PER_OVERLAP, _SHORTEST_WINDOW_SECONDS, _LONGEST_WINDOW_SECONDS)
    )


def _unusable(
    sounds: tuple[Float32Array, Float32Array], names: tuple[str, str], rate: int
) -> tuple[str, ...]:
    warnings = []
    for name, sound in zip(names, sounds, strict=True):
        if len(sound) < SHORTEST_SECONDS * rate:
            warnings.append(
                f"the {name} recording lasts {len(sound) / rate:.2f} s, {SHORTEST_SECONDS:g} s are "
                "needed"
            )
        elif float(np.sqrt(np.mean(sound**2))) < _SILENCE_RMS:
            warnings.append(f"the {name} recording is silent")
    return tuple(warnings)
