"""How long work says how far it is, without knowing who listens."""

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the fraction done [0-1] and what is being done."""


def silent(fraction: float, message: str) -> None:
    """Ignore progress; the default where nobody listens."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Return a progress that fills only ``start`` to ``stop`` of the given one."""

    def report(fraction: float, message: str) -> None:
        progress(start + (stop - start) * fraction, message)

    return report
