"""Result of a step."""

from dataclasses import dataclass, field
from pathlib import Path

from usdface.core.errors import CheckFailedError
from usdface.core.text import pluralize


@dataclass(frozen=True, repr=False)
class StepResult:
    """The result of a step, for people and scripts."""

    outputs: tuple[Path, ...]
    """Files written; empty for steps that only read."""
    summary: str
    """The result in one line."""
    notes: tuple[str, ...] = ()
    """Data that was dropped, assumed, repaired or is uncertain."""
    figures: dict[str, object] = field(default_factory=dict)
    """Measured numbers and names, ready for JSON."""
    table: tuple[str, ...] = ()
    """Lines to print; `figures` holds the same data."""
    failures: tuple[str, ...] = ()
    """Failed checks."""
    level: str = ""
    """``'good'``, ``'check'`` or ``'bad'`` if the summary begins with the verdict on a solve."""
    up_to_date: bool = False
    """Whether the outputs existed, made from the same inputs and options, so nothing ran."""

    def __repr__(self) -> str:
        files = ", ".join(path.name for path in self.outputs)
        counts = f"{pluralize(len(self.notes), 'note')}, {pluralize(len(self.figures), 'figure')}"
        return f"<StepResult: {self.summary} [{files or 'no file'}; {counts}]>"

    def require_success(self) -> None:
        """Raise CheckFailedError with all failures, if there are any."""
        if self.failures:
            raise CheckFailedError("; ".join(self.failures))

    def as_data(self) -> dict[str, object]:
        """Return the report as plain data for ``--json``."""
        return {
            "outputs": [str(path) for path in self.outputs],
            "summary": self.summary,
            "notes": list(self.notes),
            "figures": self.figures,
            "failures": list(self.failures),
            "up_to_date": self.up_to_date,
        }
