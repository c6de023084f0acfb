import numpy as np
import pytest

from usdface.numerics.solve.banded_smoothing import apply_filter_bank, filter_reach


def curves(frames: int = 300) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(frames, 3))


def impulse_response(bands: int) -> np.ndarray:
    """The filter that the bank is with its finest bands left out: gains of 0 telescope."""
    reach = filter_reach(bands)
    impulse = np.zeros((6 * reach + 1, 1))
    impulse[3 * reach] = 1.0
    response = apply_filter_bank(impulse, gains=[0.0] * bands)[:, 0]
    beyond = np.abs(np.arange(-3 * reach, 3 * reach + 1)) > reach
    assert not response[beyond].any()
    return response[~beyond]


def test_with_every_gain_one_the_bands_add_up_to_the_curves() -> None:
    given = curves()
    np.testing.assert_allclose(apply_filter_bank(given, gains=[1.0] * 5), given, atol=1e-14)


@pytest.mark.parametrize("bands", [1, 2, 3, 4])
def test_without_its_finest_bands_the_pyramid_is_one_short_filter(bands: int) -> None:
    given, kernel, reach = curves(), impulse_response(bands), filter_reach(bands)
    assert len(kernel) == 2 * reach + 1
    inside = slice(reach, -reach)
    filtered = np.stack([np.convolve(each, kernel, mode="same") for each in given.T], axis=1)
    banded = apply_filter_bank(given, gains=[0.0] * bands + [1.0, 1.0])
    # bands that are kept telescope away too, but their own ends reach further in
    further = filter_reach(bands + 2)
    np.testing.assert_allclose(
        apply_filter_bank(given, gains=[0.0] * bands)[inside], filtered[inside], atol=1e-15
    )
    np.testing.assert_allclose(banded[further:-further], filtered[further:-further], atol=1e-15)


@pytest.mark.parametrize("bands", [0, 1, 3])
def test_the_filter_answers_frequencies_as_the_product_of_cosines_says(bands: int) -> None:
    kernel, reach = impulse_response(bands), filter_reach(bands)
    turns = np.linspace(0.0, np.pi, 50)
    response = np.cos(np.outer(turns, np.arange(-reach, reach + 1))) @ kernel
    expected = np.prod([np.cos(turns * 2**band / 2) ** 4 for band in range(bands)], axis=0)
    np.testing.assert_allclose(response, np.broadcast_to(expected, response.shape), atol=1e-14)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-15)


def test_a_constant_stays_and_a_gain_lifts_its_own_band() -> None:
    still = np.full((40, 2), 0.7)
    np.testing.assert_allclose(apply_filter_bank(still, gains=[0.0, 2.0]), still, atol=1e-15)
    given = curves()
    plain, lifted = (apply_filter_bank(given, gains=[1.0, gain]) for gain in (1.0, 3.0))
    smoother, smoothest = (apply_filter_bank(given, gains=[0.0] * bands) for bands in (1, 2))
    np.testing.assert_allclose(lifted - plain, 2 * (smoother - smoothest), atol=1e-13)


def test_no_frames_and_one_frame_pass() -> None:
    assert apply_filter_bank(np.zeros((0, 2)), gains=[0.0]).shape == (0, 2)
    np.testing.assert_allclose(apply_filter_bank([[0.25]], gains=[0.0, 0.0]), [[0.25]])


def test_what_cannot_be_filtered_is_refused() -> None:
    with pytest.raises(ValueError, match="values must be finite"):
        apply_filter_bank([[np.nan]], gains=[0.0])
    with pytest.raises(ValueError, match=r"gains must be finite, got \[inf\]"):
        apply_filter_bank([[1.0]], gains=[np.inf])
    with pytest.raises(ValueError, match=r"shape \(3,\), not \(frames, curves\)"):
        apply_filter_bank([1.0, 2.0, 3.0], gains=[0.0])


def test_curves_go_on_at_their_ends_as_they_end() -> None:
    given = curves(40)
    longer = np.concatenate([np.repeat(given[:1], 20, 0), given, np.repeat(given[-1:], 20, 0)])
    gains = [0.0, 0.5, 2.0]
    whole = apply_filter_bank(longer, gains=[0.0])
    np.testing.assert_allclose(apply_filter_bank(given, gains=[0.0]), whole[20:-20], atol=1e-14)
    turned = apply_filter_bank(given[::-1], gains=gains)[::-1]
    np.testing.assert_allclose(apply_filter_bank(given, gains=gains), turned, atol=1e-14)
