import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation

from usdface.numerics.regression.multiquadric_rbf import (
    Multiquadric,
    fit_multiquadric,
    multiquadric_design,
    nearest_softness,
    predict_multiquadric,
)


def predict(model: Multiquadric, points: np.ndarray) -> np.ndarray:
    return predict_multiquadric(points, model.centres, model.softness, model.coefficients)


def pairs(count: int = 34, dimensions: int = 7) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(count, dimensions)) * 10
    return centres, np.tanh(centres @ rng.normal(size=(dimensions, 5)) / 10)


def test_softness_is_the_distance_to_the_nearest_other_centre() -> None:
    centres, _ = pairs()
    for j, own in enumerate(nearest_softness(centres)):
        others = [float(np.sqrt(((centres[j] - c) ** 2).sum())) for c in np.delete(centres, j, 0)]
        assert own == pytest.approx(min(others), rel=1e-12)


def test_a_repeated_centre_is_as_soft_as_the_next_one_is_far() -> None:
    centres = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(nearest_softness(centres), [5.0, 5.0, 5.0])


def test_the_basis_is_the_published_one() -> None:
    centres, _ = pairs()
    point, softness = np.ones(7), nearest_softness(centres)
    expected = [
        np.sqrt(((point - c) ** 2).sum() + s**2) for c, s in zip(centres, softness, strict=True)
    ]
    design = multiquadric_design(point[None], centres, softness)
    np.testing.assert_allclose(design[0], expected, rtol=1e-13)


def test_every_pair_is_met_exactly() -> None:
    centres, outputs = pairs()
    model = fit_multiquadric(centres, outputs)
    np.testing.assert_allclose(predict(model, centres), outputs, atol=1e-10)
    assert not model.ridge.any()


def test_with_one_softness_it_is_scipys_interpolant(monkeypatch: pytest.MonkeyPatch) -> None:
    centres, outputs = pairs()
    points = np.random.default_rng(1).normal(size=(200, 7)) * 10
    monkeypatch.setattr(
        "usdface.numerics.regression.multiquadric_rbf.nearest_softness",
        lambda centres: np.full(len(centres), 4.0),
    )
    model = fit_multiquadric(centres, outputs)
    theirs = RBFInterpolator(centres, outputs, kernel="multiquadric", epsilon=1 / 4.0, degree=-1)
    np.testing.assert_allclose(predict(model, points), theirs(points), atol=1e-9)


def test_turning_moving_and_scaling_the_space_changes_nothing() -> None:
    centres, outputs = pairs(dimensions=3)
    points = np.random.default_rng(1).normal(size=(50, 3)) * 10
    turn = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    moved = fit_multiquadric(5.0 * centres @ turn.T + 7.0, outputs)
    np.testing.assert_allclose(
        predict(moved, 5.0 * points @ turn.T + 7.0),
        predict(fit_multiquadric(centres, outputs), points),
        atol=1e-8,
    )


def test_outputs_do_not_disturb_each_other() -> None:
    centres, outputs = pairs()
    for smooth in (False, True):
        whole = fit_multiquadric(centres, outputs, smooth=smooth)
        alone = fit_multiquadric(centres, outputs[:, 2:3], smooth=smooth)
        np.testing.assert_allclose(whole.coefficients[:, 2:3], alone.coefficients, rtol=1e-9)


def test_smoothing_helps_with_noise() -> None:
    rng = np.random.default_rng(0)
    centres, points = rng.uniform(-1, 1, (80, 2)), rng.uniform(-1, 1, (500, 2))

    def truth(x: np.ndarray) -> np.ndarray:
        return np.sin(2 * x[:, :1]) + x[:, 1:] ** 2

    noisy = truth(centres) + 0.2 * rng.normal(size=(80, 1))
    errors = []
    for smooth in (False, True):
        model = fit_multiquadric(centres, noisy, smooth=smooth)
        errors.append(np.abs(predict(model, points) - truth(points)).mean())
    assert errors[1] < 0.5 * errors[0]


def test_blocks_do_not_change_the_prediction(monkeypatch: pytest.MonkeyPatch) -> None:
    centres, outputs = pairs()
    model = fit_multiquadric(centres, outputs)
    points = np.random.default_rng(1).normal(size=(23, 7))
    whole = predict(model, points)
    monkeypatch.setattr("usdface.numerics.regression.rbf_ridge.BLOCK_ROWS", 5)
    np.testing.assert_allclose(predict(model, points), whole, rtol=1e-12)


def test_centres_that_coincide_are_named_and_can_be_smoothed_over() -> None:
    centres, outputs = pairs()
    centres[9] = centres[4]
    with pytest.raises(ValueError, match=r"centres 4 and 9 coincide.*smooth"):
        fit_multiquadric(centres, outputs)
    assert np.isfinite(fit_multiquadric(centres, outputs, smooth=True).coefficients).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outputs": np.zeros((3, 2))}, "do not pair up"),
        ({"centres": np.full((34, 7), np.nan)}, "not finite"),
        ({"centres": np.zeros((34, 7))}, "all 34 centres coincide"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change: dict[str, np.ndarray], message: str) -> None:
    centres, outputs = pairs()
    given = {"centres": centres, "outputs": outputs} | change
    with pytest.raises(ValueError, match=message):
        fit_multiquadric(**given)
