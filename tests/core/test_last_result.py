"""A result is computed again if the content of an argument has changed, in place as well."""

from functools import cached_property

import numpy as np

from usdface.core.last_result import cache_last_result


def test_only_other_content_is_computed_again() -> None:
    computed = []

    @cache_last_result
    def total(values: np.ndarray, *, scale: float = 1.0) -> float:
        computed.append(scale)
        return scale * float(values.sum())

    values = np.arange(20_000.0).reshape(2, -1)
    assert total(values) == total(values.copy()) == values.sum()
    assert len(computed) == 1
    values[1, -1] += 1
    assert total(values) == values.sum()
    assert total(values, scale=2.0) == 2 * values.sum()
    assert total(values.T) == values.sum()
    total(values.astype(np.float32))
    assert len(computed) == 5


def test_sets_have_content() -> None:
    @cache_last_result
    def count(names: frozenset[str]) -> int:
        return len(names)

    assert count(frozenset("ab")) == 2
    assert count(frozenset("abc")) == 3


def test_cached_properties_are_not_content() -> None:
    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

        @cached_property
        def size(self) -> int:
            return len(self.name)

    computed = []

    @cache_last_result
    def described(named: Named) -> str:
        computed.append(named.name)
        return named.name

    one = Named("one")
    described(one)
    assert one.size == 3
    described(one)
    described(Named("two"))
    assert computed == ["one", "two"]
