"""Exceptions from the rules of `tests.structure`, by rule and place, each with its reason."""

ALLOWED: dict[str, dict[str, str]] = {}
