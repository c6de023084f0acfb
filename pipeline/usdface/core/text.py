"""Words in messages that depend on a number."""


def pluralize(count: int, noun: str) -> str:
    """Return a number with its noun, ``1 shape`` or ``3 shapes``.

    Parameters
    ----------
    count : int
        At least 0.
    noun : str
        In the singular; one whose plural ends in s.
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
