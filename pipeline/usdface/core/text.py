"""Numbers and lists as messages write them."""

from collections.abc import Iterable


def pluralize(count: int, noun: str) -> str:
    """Return a number with its noun, ``1 shape`` or ``3 shapes``.

    Parameters
    ----------
    noun : str
        In the singular; one whose plural ends in s.
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def first_few(names: Iterable[object], *, most: int = 5) -> str:
    """Return names as a list that stays short: ``a, b, c and 4 more``."""
    written = list(map(str, names))
    rest = len(written) - most
    return ", ".join(written[:most]) + (f" and {rest} more" if rest > 0 else "")
