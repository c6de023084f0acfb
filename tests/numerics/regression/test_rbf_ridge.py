import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.optimize import minimize_scalar
from sklearn.kernel_ridge import KernelRidge

from usdface.numerics.regression.rbf_ridge import (
    RBFRidge,
    centre_widths,
    choose_ridge,
    effective_freedom,
    fit_rbf_ridge,
    gaussian_design,
    gcv_scores,
    predict_rbf_ridge,
    reestimate_ridge,
    rotate,
    shared_widths,
    smallest_ridge,
)


def predict(model: RBFRidge, points: np.ndarray) -> np.ndarray:
    return predict_rbf_ridge(points, model.centres, model.widths, model.coefficients)


def pairs(count: int = 40, dimensions: int = 4, outputs: int = 5, noise: float = 0.05):
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(count, dimensions))
    smooth = np.sin(centres @ rng.normal(size=(dimensions, outputs)))
    return centres, smooth + noise * rng.normal(size=smooth.shape)


@pytest.mark.parametrize("per_centre", [False, True], ids=["shared", "per centre"])
def test_coefficients_solve_equation_6(per_centre: bool) -> None:
    centres, outputs = pairs()
    widths = centre_widths(centres) if per_centre else shared_widths(centres, multiple=3.0)
    ridge = 0.03
    model = fit_rbf_ridge(centres, outputs, widths=widths, ridge=ridge)
    away = np.linalg.norm(centres[:, None] - centres, axis=2)
    design = np.exp(-(away**2) / (2 * widths**2))  # H_ij = phi_j(CF_i)
    normal = design.T @ design + ridge * np.eye(len(design))
    expected = np.linalg.solve(normal, design.T @ outputs)
    np.testing.assert_allclose(model.coefficients, expected, rtol=1e-6, atol=1e-9)


def test_coefficients_minimise_the_cost_of_equation_5() -> None:
    centres, outputs = pairs(outputs=1)
    widths = shared_widths(centres, multiple=2.0)
    model = fit_rbf_ridge(centres, outputs, widths=widths, ridge=0.1)
    design = gaussian_design(centres, centres, widths)

    def cost(coefficients: np.ndarray) -> float:
        return float(((outputs - design @ coefficients) ** 2).sum() + 0.1 * (coefficients**2).sum())

    rng = np.random.default_rng(1)
    best = cost(model.coefficients)
    for _ in range(20):
        step = 1e-3 * rng.normal(size=model.coefficients.shape)
        assert cost(model.coefficients + step) > best


def test_weight_decay_equals_kernel_ridge_only_at_a_transformed_kernel() -> None:
    """(H'H + rI)^-1 H'W is kernel ridge of the kernel HH', not of H, at the same ridge."""
    centres, outputs = pairs()
    widths = shared_widths(centres, multiple=2.0)
    new = np.random.default_rng(2).normal(size=(30, 4))
    ours = predict(fit_rbf_ridge(centres, outputs, widths=widths, ridge=0.05), new)
    design = gaussian_design(centres, centres, widths)
    same = KernelRidge(alpha=0.05, kernel="precomputed").fit(design @ design.T, outputs)
    np.testing.assert_allclose(
        ours, same.predict(gaussian_design(new, centres, widths) @ design.T), atol=1e-8
    )
    gamma = 0.5 / widths[0] ** 2
    other = KernelRidge(alpha=0.05, kernel="rbf", gamma=gamma).fit(centres, outputs).predict(new)
    assert np.abs(ours - other).max() > 0.02


def test_a_vanishing_ridge_interpolates_as_scipy_does() -> None:
    centres, outputs = pairs(count=25)
    widths = shared_widths(centres, multiple=1.0)
    new = np.random.default_rng(2).normal(size=(30, 4))
    ours = predict(fit_rbf_ridge(centres, outputs, widths=widths, ridge=1e-14), new)
    scipy = RBFInterpolator(
        centres, outputs, kernel="gaussian", epsilon=1 / (np.sqrt(2) * widths[0]), degree=-1
    )
    np.testing.assert_allclose(ours, scipy(new), atol=1e-8)


def test_gcv_from_one_decomposition_equals_its_definition() -> None:
    centres, outputs = pairs()
    design = gaussian_design(centres, centres, shared_widths(centres))
    ridges = np.array([1e-4, 1e-2, 1.0])
    scores = gcv_scores(rotate(design, outputs), ridges)
    count = len(design)
    for ridge, row in zip(ridges, scores, strict=True):
        hat = design @ np.linalg.solve(design.T @ design + ridge * np.eye(count), design.T)
        left = np.eye(count) - hat
        expected = count * ((left @ outputs) ** 2).sum(axis=0) / np.trace(left) ** 2
        np.testing.assert_allclose(row, expected, rtol=1e-6)
        freedom = effective_freedom(np.linalg.svd(design)[1], np.array([ridge]))
        np.testing.assert_allclose(freedom, np.trace(hat), rtol=1e-6)


def test_effective_freedom_stays_within_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    centres, outputs = pairs(noise=0.0)  # without noise GCV would use up every pair
    widths = shared_widths(centres, multiple=1.0)
    model = fit_rbf_ridge(centres, outputs, widths=widths)
    assert (model.freedom <= 0.8 * len(centres) * (1 + 1e-9)).all()
    monkeypatch.setattr("usdface.numerics.regression.rbf_ridge.FREEDOM_LIMIT", 1.0)
    loose = fit_rbf_ridge(centres, outputs, widths=widths)
    assert loose.freedom.max() > 0.9 * len(centres)
    singular = rotate(gaussian_design(centres, centres, widths), outputs).singular
    floor = smallest_ridge(singular, freedom=20.0)
    np.testing.assert_allclose(effective_freedom(singular, np.array([floor])), 20.0, rtol=1e-9)


def test_the_papers_iteration_ends_at_a_stationary_point_of_gcv(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    centres, outputs = pairs(noise=0.2)
    rotated = rotate(gaussian_design(centres, centres, shared_widths(centres, multiple=3)), outputs)
    found = reestimate_ridge(rotated, start=1e-3, tolerance=1e-13, max_iterations=20000)
    for column, ridge in enumerate(found):

        def score(log_ridge: float, column: int = column) -> float:
            return float(gcv_scores(rotated, np.array([np.exp(log_ridge)]))[0, column])

        at = np.log(ridge)
        local = minimize_scalar(score, bounds=(at - 1, at + 1), method="bounded")
        assert score(at) == pytest.approx(local.fun, rel=1e-4)
    monkeypatch.setattr("usdface.numerics.regression.rbf_ridge.FREEDOM_LIMIT", 1.0)
    chosen = choose_ridge(rotated)
    for column in range(len(found)):
        assert (
            gcv_scores(rotated, chosen[column : column + 1])[0, column]
            <= gcv_scores(rotated, found[column : column + 1])[0, column] * 1.001
        )


def test_all_outputs_at_once_equal_each_output_alone() -> None:
    centres, outputs = pairs()
    widths = shared_widths(centres)
    together = fit_rbf_ridge(centres, outputs, widths=widths)
    for column in range(outputs.shape[1]):
        alone = fit_rbf_ridge(centres, outputs[:, [column]], widths=widths)
        np.testing.assert_allclose(alone.ridge, together.ridge[[column]])
        np.testing.assert_allclose(
            alone.coefficients, together.coefficients[:, [column]], rtol=1e-8, atol=1e-12
        )


def test_shift_and_scale_of_the_input_change_nothing() -> None:
    centres, outputs = pairs()
    new = np.random.default_rng(2).normal(size=(10, 4))
    first = fit_rbf_ridge(centres, outputs, widths=shared_widths(centres))
    moved = centres * 7.0 + 100.0
    second = fit_rbf_ridge(moved, outputs, widths=shared_widths(moved))
    np.testing.assert_allclose(predict(first, new), predict(second, new * 7.0 + 100.0), atol=1e-6)


def test_prediction_does_not_depend_on_the_block_size(monkeypatch: pytest.MonkeyPatch) -> None:
    centres, outputs = pairs()
    model = fit_rbf_ridge(centres, outputs, widths=shared_widths(centres))
    new = np.random.default_rng(2).normal(size=(101, 4))
    whole = predict(model, new)
    monkeypatch.setattr("usdface.numerics.regression.rbf_ridge.BLOCK_ROWS", 7)
    np.testing.assert_allclose(predict(model, new), whole, atol=1e-12)


def test_widths_follow_the_nearest_neighbour_and_survive_coinciding_centres() -> None:
    points = np.array([[0.0], [1.0], [1.0], [4.0]])
    np.testing.assert_array_equal(centre_widths(points, multiple=2.0), [2.0, 4.0, 4.0, 6.0])
    np.testing.assert_array_equal(shared_widths(points, multiple=8.0), np.full(4, 16.0))
    with pytest.raises(ValueError, match="all centres coincide"):
        shared_widths(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="at least 2 points"):
        centre_widths(np.zeros((1, 2)))


def test_bad_input_is_refused() -> None:
    centres, outputs = pairs()
    widths = shared_widths(centres)
    with pytest.raises(ValueError, match="do not pair up"):
        fit_rbf_ridge(centres[:-1], outputs, widths=widths)
    with pytest.raises(ValueError, match="not finite"):
        fit_rbf_ridge(centres, outputs * np.nan, widths=widths)
