"""Exceptions from the rules of `tests.structure`, by rule and place, each with its reason."""

ALLOWED: dict[str, dict[str, str]] = {
    "small file": {
        "model/regressions/additive": "every regression is a file of its own, as its neighbours",
    },
}
