"""Combinations by hand, against differences, and what is refused."""

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination, RigLogic, logic_of, order_combinations

SHAPES = ("a", "b", "c")


def made(*combinations: Combination) -> RigLogic:
    names = (*SHAPES, *(each.shape for each in combinations))
    return RigLogic(SHAPES, order_combinations(combinations, names, source="rig.usda"))


def test_modes_are_as_their_formulas_say() -> None:
    logic = made(
        Combination("p", ("a", "b", "c")),
        Combination("m", ("a", "b"), "minimum"),
        Combination("s", ("a", "b", "c"), "smooth"),
    )
    a, b, c = weights = np.array([0.2, 0.5, 0.9])
    p, m, s = logic.evaluate(weights[None])[0, 3:]
    np.testing.assert_allclose([p, m, s], [a * b * c, a, 3 / (1 / a + 1 / b + 1 / c)])
    assert not logic.evaluate(np.array([[-0.4, 1.0, 0.0]]))[0, 3:].any()


def test_an_in_between_reaches_to_those_next_to_it_or_as_far_as_stated() -> None:
    logic = made(
        Combination("a25", ("a",), weights=(0.25,)),
        Combination("a50", ("a",), weights=(0.5,)),
        Combination("b50", ("b",), weights=(0.5,), spans=((0.4, 0.9),)),
        Combination("corner", ("a50", "c")),
    )
    at = np.array([[0.125, 0.45, 1.0], [0.25, 0.7, 1.0], [0.375, 0.3, 0.5], [0.75, 0.95, 0.5]])
    expected = [[0.5, 0, 0.5, 0], [1, 0, 0.5, 0], [0.5, 0.5, 0, 0.25], [0, 0.5, 0, 0.25]]
    np.testing.assert_allclose(logic.evaluate(at)[:, 3:], expected, atol=1e-12)


def test_slopes_are_those_of_differences() -> None:
    logic = made(
        Combination("ab", ("a", "b")),
        Combination("low", ("ab", "c"), "minimum"),
        Combination("soft", ("a50", "c"), "smooth"),
        Combination("a50", ("a",), weights=(0.5,)),
    )
    weights, step = np.random.default_rng(0).uniform(0.05, 0.95, (20, 3)), 1e-7
    expected = np.stack(
        [
            (logic.evaluate(weights + step * axis) - logic.evaluate(weights))[:, 3:] / step
            for axis in np.eye(3)
        ],
        axis=2,
    )
    np.testing.assert_allclose(logic.slopes(weights), expected, atol=1e-4)


def test_weights_by_name_gain_what_they_drive() -> None:
    logic = logic_of(("c", "a"), (Combination("ab", ("a", "b")), Combination("ac", ("a", "c"))))
    assert logic is not None
    full = logic.complete(np.array([[0.5, 0.8]]), ("c", "a"))
    np.testing.assert_allclose(full, [[0.5, 0.8, 0.0, 0.4]])
    assert logic_of(("a",), ()) is None


@pytest.mark.parametrize(
    ("combinations", "message"),
    [
        pytest.param([Combination("x", ("a", "q"))], "q is no shape of the rig", id="missing"),
        pytest.param([Combination("z", ("a",))], "z is no shape of the rig", id="no such shape"),
        pytest.param(
            [Combination("x", ("y", "a")), Combination("y", ("x", "b"))],
            "a cycle: x <- y <- x",
            id="cycle",
        ),
        pytest.param([Combination("x", ("x", "a"))], "a cycle: x <- x", id="itself"),
        pytest.param([Combination("x", ("a", "a"))], "names a part twice", id="twice"),
        pytest.param(
            [Combination("x", ("a",)), Combination("x", ("b",))],
            "x is stated 2 times",
            id="stated twice",
        ),
        pytest.param([Combination("x", ())], "has no parts", id="empty"),
        pytest.param(
            [Combination("x", ("a", "b"), weights=(0.5,))], "1 weights for 2 parts", id="weights"
        ),
        pytest.param(
            [Combination("x", ("a",), weights=(float("nan"),))], "above 0 and at most 1", id="NaN"
        ),
        pytest.param(
            [Combination("x", ("a",), weights=(0.5,), spans=((0.6, 1.0),))],
            "does not hold its part's weight",
            id="span",
        ),
        pytest.param(
            [Combination("x", ("a", "b"), "max")],  # type: ignore[arg-type]
            "mode is 'max', not product, minimum, smooth",
            id="mode",
        ),
    ],
)
def test_what_cannot_be_evaluated_is_named(combinations: list[Combination], message: str) -> None:
    with pytest.raises(InputError, match=r"rig.usda: .*combination.* cannot be used") as raised:
        order_combinations(combinations, ("a", "b", "c", "x", "y"), source="rig.usda")
    assert message in str(raised.value)
