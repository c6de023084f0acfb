"""Progress callbacks of long work."""

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the fraction done [0-1] and the current activity."""


def silent(fraction: float, message: str) -> None:
    """Ignore progress."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Return a progress that maps 0 to 1 to ``start`` to ``stop`` of another."""

    def report(fraction: float, message: str) -> None:
        progress(start + (stop - start) * fraction, message)

    return report
