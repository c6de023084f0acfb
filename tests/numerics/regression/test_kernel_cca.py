import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.distance import cdist

from usdface.numerics.regression.kernel_cca import (
    KernelCCA,
    fit_kernel_cca,
    median_width,
    predict_expansion,
)

KAPPA, WIDTH = 1e-2, 2.0


def predict(model: KernelCCA, points: np.ndarray) -> np.ndarray:
    return predict_expansion(points, model.centres, model.width, model.operator, model.intercept)


def pairs(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    sources = rng.normal(size=(count, 4))
    return sources, np.tanh(sources @ rng.normal(size=(4, 6))) + 0.1 * rng.normal(size=(count, 6))


def fit(sources: np.ndarray, targets: np.ndarray, **changes: object) -> KernelCCA:
    given: dict[str, object] = {
        "source_width": WIDTH,
        "target_width": WIDTH,
        "kappa": KAPPA,
    }
    return fit_kernel_cca(sources, targets, **(given | changes))  # type: ignore[arg-type]


def gaussian(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.exp(-cdist(left, right, "sqeuclidean") / (2 * WIDTH**2))


def by_dense_eigenvalues(
    sources: np.ndarray, targets: np.ndarray, new: np.ndarray, components: int, lines: str
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 5-8 as one generalised eigenvalue problem of twice the pairs' size, then two lines."""
    n = len(sources)
    centring = np.eye(n) - 1 / n
    A, B = (centring @ gaussian(x, x) @ centring for x in (sources, targets))
    off_constant = scipy.linalg.null_space(np.ones((1, n)))  # on which both are invertible
    a, b = (off_constant.T @ x @ off_constant for x in (A, B))
    m, penalty, zero = n - 1, KAPPA * n, np.zeros((n - 1, n - 1))
    values, vectors = scipy.linalg.eigh(
        np.block([[zero, a @ b], [b @ a, zero]]),
        np.block([[a @ a + penalty * a, zero], [zero, b @ b + penalty * b]]),
    )
    best = np.argsort(-values)[:components]
    vectors = vectors[:, best] * np.sqrt(2)  # each half of unit length by itself
    hs, ht = off_constant @ vectors[:m], off_constant @ vectors[m:]
    s, t, mean = A @ hs, B @ ht, targets.mean(axis=0)
    extra = penalty if lines == "penalised" else 0.0
    across = np.linalg.solve(s.T @ s + extra * hs.T @ A @ hs, s.T @ t)
    back = np.linalg.solve(t.T @ t + extra * ht.T @ B @ ht, t.T @ (targets - mean))
    k = gaussian(new, sources)
    own = gaussian(sources, sources)
    k = k - k.mean(axis=1, keepdims=True) - own.mean(axis=0) + own.mean()
    return values[best], k @ hs @ across @ back + mean


@pytest.mark.parametrize("lines", ["published", "penalised"])
def test_it_agrees_with_a_dense_generalised_eigenvalue_problem(lines: str) -> None:
    sources, targets = pairs()
    new = np.random.default_rng(1).normal(size=(100, 4))
    correlations, predicted = by_dense_eigenvalues(sources, targets, new, 6, lines)
    model = fit(sources, targets, components=6, lines=lines)
    np.testing.assert_allclose(model.correlations, correlations, rtol=1e-9)
    np.testing.assert_allclose(predict(model, new), predicted, atol=1e-8)


def test_with_every_direction_it_is_ridge_regression_onto_smoothed_targets() -> None:
    sources, targets = pairs()
    n, penalty = len(sources), KAPPA * len(sources)
    centring = np.eye(n) - 1 / n
    A, B = (centring @ gaussian(x, x) @ centring for x in (sources, targets))
    eye, mean = np.eye(n), targets.mean(axis=0)
    smoothed = B @ np.linalg.solve(B + penalty * eye, targets - mean)
    fitted = A @ np.linalg.solve(A + penalty * eye, smoothed) + mean
    np.testing.assert_allclose(predict(fit(sources, targets), sources), fitted, atol=1e-8)


def test_the_published_lines_over_every_direction_undo_the_penalty() -> None:
    sources, targets = pairs(count=20)
    for kappa in (1e-4, 1.0):
        model = fit(sources, targets, kappa=kappa, lines="published")
        np.testing.assert_allclose(predict(model, sources), targets, atol=1e-6)


def test_the_operator_has_as_many_directions_as_are_asked_for() -> None:
    sources, targets = np.random.default_rng(0).normal(size=(2, 40, 8))
    model = fit(sources, targets, components=5, lines="published")
    assert len(model.correlations) == np.linalg.matrix_rank(model.operator) == 5


def test_correlations_fall_with_the_penalty_and_stay_below_one() -> None:
    sources, targets = pairs()
    first = [float(fit(sources, targets, kappa=k).correlations[0]) for k in (1e-6, 1e-3, 1.0)]
    assert 1.0 > first[0] > first[1] > first[2] > 0.0
    correlations = fit(sources, targets).correlations
    assert (np.diff(correlations) <= 0).all()


def test_related_targets_correlate_more_than_unrelated_ones() -> None:
    sources, targets = pairs()
    noise = np.random.default_rng(2).normal(size=targets.shape)
    related, unrelated = (fit(sources, t).correlations[:3].mean() for t in (targets, noise))
    assert related > unrelated + 0.1


def test_a_bent_relation_is_learned() -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, np.pi, (60, 1))
    sources = np.hstack([np.cos(angle), np.sin(angle)])
    model = fit(sources, angle, kappa=1e-6, source_width=1.0, target_width=1.0)
    new = np.linspace(0.2, 2.9, 50)[:, None]
    predicted = predict(model, np.hstack([np.cos(new), np.sin(new)]))
    np.testing.assert_allclose(predicted, new, atol=0.02)


def test_moving_and_scaling_the_source_with_its_width_changes_nothing() -> None:
    sources, targets = pairs()
    new = np.random.default_rng(1).normal(size=(30, 4))
    moved = fit(3.0 * sources + 5.0, targets, source_width=3.0 * WIDTH)
    np.testing.assert_allclose(
        predict(moved, 3.0 * new + 5.0),
        predict(fit(sources, targets), new),
        atol=1e-9,
    )


def test_median_width_is_a_distance() -> None:
    points = np.array([[0.0], [1.0], [3.0]])
    assert median_width(points, multiple=2.0) == 4.0
    mostly_one = np.array([[0.0], [0.0], [0.0], [0.0], [5.0]])
    assert median_width(mostly_one) > 0
    with pytest.raises(ValueError, match="all 3 points coincide"):
        median_width(np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"targets": np.zeros((3, 2))}, "do not pair up"),
        ({"targets": np.full((40, 6), np.inf)}, "not finite"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change: dict[str, object], message: str) -> None:
    sources, targets = pairs()
    given = {"sources": sources, "targets": targets} | change
    with pytest.raises(ValueError, match=message):
        fit(given.pop("sources"), given.pop("targets"), **given)  # type: ignore[arg-type]
