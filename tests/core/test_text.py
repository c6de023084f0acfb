from usdface.core.text import first_few, pluralize


def test_one_of_a_thing_is_not_a_plural() -> None:
    assert [pluralize(n, "shape") for n in (0, 1, 2)] == ["0 shapes", "1 shape", "2 shapes"]


def test_a_long_list_names_its_first_and_counts_the_rest() -> None:
    assert first_few(["a", "b"], most=2) == "a, b"
    assert first_few(range(12), most=3) == "0, 1, 2 and 9 more"
    assert first_few([]) == ""
