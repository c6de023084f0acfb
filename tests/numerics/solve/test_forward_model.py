import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from usdface.numerics.solve.forward_model import (
    ForwardModel,
    Solve,
    fit_forward_model,
    solve_forward_model,
)

SHAPES, DIMENSIONS = 6, 12
RANGES = np.tile([0.0, 1.0], (SHAPES, 1))


def face() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(SHAPES, DIMENSIONS)) * 10, rng.normal(size=DIMENSIONS)


def acted(frames: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (frames, SHAPES))


def given(**changes: np.ndarray) -> ForwardModel:
    basis, offset = face()
    parts = {
        "basis": basis,
        "offset": offset,
        "noise": np.linspace(0.5, 2.0, DIMENSIONS),
        "weight_mean": np.full(SHAPES, 0.3),
        "weight_precision": np.eye(SHAPES) * 4.0,
    }
    return ForwardModel(**(parts | changes))


@pytest.mark.parametrize("solve", ["lstsq", "nnls", "bounded"])
def test_a_straight_face_is_recovered(solve: Solve) -> None:
    basis, offset = face()
    pairs, new = acted(40), acted(100, seed=2)
    model = fit_forward_model(pairs, pairs @ basis + offset)
    np.testing.assert_allclose(model.basis, basis, atol=1e-3)
    np.testing.assert_allclose(model.offset, offset, atol=1e-3)
    solved = solve_forward_model(model, new @ basis + offset, solve=solve, ranges=RANGES)
    np.testing.assert_allclose(solved, new, atol=2e-3)


def test_each_way_is_scipys() -> None:
    model = given()
    motion = np.random.default_rng(3).normal(size=(20, DIMENSIONS)) * 10
    A, b = (model.basis / model.noise).T, (motion - model.offset) / model.noise
    plain, positive, bounded = (
        solve_forward_model(model, motion, solve=solve, ranges=RANGES)
        for solve in ("lstsq", "nnls", "bounded")
    )
    root = 2.0 * np.eye(SHAPES)  # of the precision
    stacked = np.vstack([A, root])
    for frame, target in enumerate(b):
        np.testing.assert_allclose(plain[frame], np.linalg.lstsq(A, target)[0], atol=1e-9)
        np.testing.assert_allclose(positive[frame], nnls(A, target)[0], atol=1e-4)
        usual = np.concatenate([target, root @ model.weight_mean])
        theirs = lsq_linear(stacked, usual, bounds=(0, 1), tol=1e-12).x
        np.testing.assert_allclose(bounded[frame], theirs, atol=1e-6)


def test_where_motion_says_nothing_the_usual_weight_stands() -> None:
    basis, _ = face()
    silent = basis.copy()
    silent[4] = 0.0
    model = given(basis=silent)
    solved = solve_forward_model(
        model, acted(30) @ silent + model.offset, solve="bounded", ranges=RANGES
    )
    np.testing.assert_allclose(solved[:, 4], 0.3, atol=1e-6)


def test_noisier_dimensions_count_less() -> None:
    basis, offset = face()
    rng = np.random.default_rng(4)
    pairs = acted(200)
    noise = np.where(np.arange(DIMENSIONS) < 6, 5.0, 0.1) * rng.normal(size=(200, DIMENSIONS))
    model = fit_forward_model(pairs, pairs @ basis + offset + noise)
    assert model.noise[:6].min() > 10 * model.noise[6:].max()
    np.testing.assert_allclose(model.noise[:6], 5.0, rtol=0.3)


def test_weights_that_never_change_explain_nothing() -> None:
    motion = np.random.default_rng(0).normal(size=(10, DIMENSIONS))
    model = fit_forward_model(np.full((10, SHAPES), 0.4), motion)
    assert not model.basis.any()
    solved = solve_forward_model(model, motion, solve="bounded", ranges=RANGES)
    np.testing.assert_allclose(solved, 0.4, atol=1e-9)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="do not fit a basis of 6 shapes in 12"):
        solve_forward_model(given(), np.zeros((3, 5)), solve="bounded", ranges=RANGES)
    with pytest.raises(ValueError, match="got 'magic'"):
        solve_forward_model(given(), np.zeros((3, 12)), solve="magic", ranges=RANGES)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="do not pair up"):
        fit_forward_model(acted(5), np.zeros((4, 12)))
