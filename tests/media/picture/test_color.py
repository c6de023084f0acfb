import numpy as np

from usdface.media.picture.color import (
    bytes_from_linear,
    heat_ramp,
    linear_from_srgb,
    srgb_from_linear,
)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Viénot, Brettel and Mollon (1999): what remains of linear RGB without red or green cones.
PROTANOPE = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]])
DEUTERANOPE = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])


def test_ramp_climbs_in_luminance_without_a_flat_step() -> None:
    light = heat_ramp(np.linspace(0, 1, 101)) @ LUMINANCE
    lightness = np.cbrt(light)
    steps = np.diff(lightness)
    assert steps.min() > 0
    assert steps.max() < 3 * steps.min()


def test_ramp_climbs_for_colour_blind_eyes_too() -> None:
    ramp = heat_ramp(np.linspace(0, 1, 101))
    for missing in (PROTANOPE, DEUTERANOPE):
        assert np.diff((ramp @ missing.T) @ LUMINANCE).min() > 0


def test_ramp_ends_hold_beyond_the_range_and_unknown_is_grey() -> None:
    np.testing.assert_array_equal(heat_ramp([-5, 0]), heat_ramp([0, -1]))
    np.testing.assert_array_equal(heat_ramp([9.0], high=3), heat_ramp([3.0], high=3))
    grey = heat_ramp([np.nan])[0]
    assert np.ptp(grey) == 0


def test_srgb_round_trip_is_exact_in_bytes() -> None:
    codes = np.arange(256)
    linear = linear_from_srgb(codes / 255)
    np.testing.assert_allclose(srgb_from_linear(linear) * 255, codes, atol=1e-9)
    assert np.abs(bytes_from_linear(linear).astype(int) - codes).max() <= 1
