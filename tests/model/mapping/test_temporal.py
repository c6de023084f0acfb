import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.model.mapping.temporal import TemporalSolve, smooth_weights

RATE = 60.0
RANGES = np.array([[0.0, 1.0], [0.0, 1.0]])


def shaky_blinks(frames: int = 900) -> tuple[np.ndarray, np.ndarray]:
    """A smile and blinks of a seventh of a second, and the same with jitter."""
    rng = np.random.default_rng(0)
    time = np.arange(frames)
    smile = 0.5 + 0.3 * np.sin(time / 40)
    blink = np.exp(-(((time % 90 - 45) / 3.5) ** 2))
    truth = np.stack([smile, blink], axis=1)
    return truth, np.clip(truth + 0.02 * rng.normal(size=truth.shape), 0, 1)


def roughness(weights: np.ndarray) -> float:
    return float(np.abs(np.diff(weights, 3, axis=0)).mean())


def smoothed(
    weights: np.ndarray, solve: TemporalSolve, uncertainty: float = 0.0, rate: float = RATE
) -> np.ndarray:
    return smooth_weights(
        weights,
        uncertainty_mm=np.full(len(weights), uncertainty),
        ranges=RANGES,
        rate=rate,
        solve=solve,
    )


@pytest.mark.parametrize("mode", ["whole", "causal"])
def test_jitter_goes_and_blinks_stay(mode: str) -> None:
    truth, shaky = shaky_blinks()
    calm = smoothed(shaky, TemporalSolve(mode))  # type: ignore[arg-type]
    assert roughness(calm) < 0.7 * roughness(shaky)
    peaks = truth[:, 1] > 0.98
    assert abs((calm - truth)[peaks, 1].mean()) < 0.02
    assert calm.min() >= 0.0
    assert calm.max() <= 1.0


@pytest.mark.parametrize("sure", [1.0, 0.1])
@pytest.mark.parametrize("cutoff", [None, 4.0, 1.0])
@pytest.mark.parametrize("mode", ["whole", "causal", "bands"])
def test_windows_with_a_margin_are_the_whole_take(
    mode: str, cutoff: float | None, sure: float
) -> None:
    _, shaky = shaky_blinks(1500)
    solve = TemporalSolve(mode, cutoff)  # type: ignore[arg-type]
    margin = solve.margin_at(RATE)
    whole = smoothed(shaky, solve, sure)
    window = smoothed(shaky[700 - margin : 800 + margin], solve, sure)
    np.testing.assert_allclose(window[margin:-margin], whole[700:800], atol=1e-9)


def test_the_margin_is_as_wide_as_the_cutoff_is_low_and_not_less_than_before() -> None:
    margins = [TemporalSolve("whole", cutoff).margin_at(RATE) for cutoff in (20.0, 8.0, 2.0, 1.0)]
    assert margins[:2] == [64, 64]
    assert 2 * margins[2] == pytest.approx(margins[3], rel=0.01)
    assert TemporalSolve().margin_at(RATE) == 0
    assert TemporalSolve("bands", bands=7).margin_at(RATE) == 254


@pytest.mark.parametrize("mode", ["whole", "causal"])
@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0])
def test_film_rates_are_smoothed_without_a_cutoff(mode: str, rate: float) -> None:
    _, shaky = shaky_blinks()
    solve = TemporalSolve(mode)  # type: ignore[arg-type]
    calm = smoothed(shaky, solve, rate=rate)
    assert roughness(calm) < roughness(shaky)
    explicit = TemporalSolve(mode, 0.4 * rate)  # type: ignore[arg-type]
    np.testing.assert_array_equal(calm, smoothed(shaky, explicit, rate=rate))
    with pytest.raises(InputError, match="half the rate"):
        smoothed(shaky, TemporalSolve(mode, 20.0), rate=rate)  # type: ignore[arg-type]


def test_ordinary_rates_are_cut_off_at_20_hz() -> None:
    assert [TemporalSolve().cutoff_at(rate) for rate in (50.0, 60.0, 120.0)] == [20.0] * 3


def test_the_causal_mode_knows_no_more_than_its_lag() -> None:
    _, shaky = shaky_blinks(200)
    changed = shaky.copy()
    changed[103:] = 0.5
    solve = TemporalSolve("causal", lag=2)
    first, second = smoothed(shaky, solve), smoothed(changed, solve)
    np.testing.assert_array_equal(first[:101], second[:101])
    assert (first[101] != second[101]).any()


def test_an_uncertain_frame_follows_its_neighbours() -> None:
    weights = np.full((60, 2), 0.5)
    weights[30] = 0.9
    sure = np.zeros(60)
    unsure = sure.copy()
    unsure[30] = 9.0
    found = [
        smooth_weights(
            weights, uncertainty_mm=each, ranges=RANGES, rate=RATE, solve=TemporalSolve("whole")
        )[30, 0]
        for each in (sure, unsure)
    ]
    assert found[1] < found[0] - 0.03


def test_a_cutoff_beyond_what_the_rate_holds_is_refused() -> None:
    with pytest.raises(InputError, match="half the rate of 60 frames per second, got 40 Hz"):
        smoothed(np.zeros((10, 2)), TemporalSolve("whole", cutoff_hz=40.0))


def test_the_published_filter_bank_calms_and_every_band_costs_blinks_more() -> None:
    truth, shaky = shaky_blinks()
    peaks = truth[:, 1] > 0.98
    lost, rough = [], []
    for bands in (1, 2, 3):
        calm = smoothed(shaky, TemporalSolve("bands", bands=bands))
        assert calm.min() >= 0.0
        assert calm.max() <= 1.0
        lost.append(-(calm - truth)[peaks, 1].mean())
        rough.append(roughness(calm))
    assert lost == sorted(lost)
    assert lost[0] < 0.1
    assert lost[2] > 0.15
    assert rough == sorted(rough, reverse=True)
    assert rough[0] < 0.3 * roughness(shaky)
