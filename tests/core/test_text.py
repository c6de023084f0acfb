from usdface.core.text import pluralize


def test_one_of_a_thing_is_not_a_plural() -> None:
    assert [pluralize(n, "shape") for n in (0, 1, 2)] == ["0 shapes", "1 shape", "2 shapes"]
