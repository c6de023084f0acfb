"""What a step says when it is done."""

from dataclasses import dataclass, field
from pathlib import Path

from usdface.core.errors import CheckFailedError
from usdface.core.text import pluralize


@dataclass(frozen=True, repr=False)
class StepResult:
    """The result of a step, for people and scripts."""

    outputs: tuple[Path, ...]
    """Files written; empty where the step only looked."""
    summary: str
    """One line that says what came out."""
    notes: tuple[str, ...] = ()
    """What the user should know: things dropped, assumed, repaired, doubtful."""
    figures: dict[str, object] = field(default_factory=dict)
    """Numbers and names worth keeping, ready for JSON."""
    table: tuple[str, ...] = ()
    """Lines for people; scripts find the same in `figures`."""
    failures: tuple[str, ...] = ()
    """What was checked and is not in order."""
    level: str = ""
    """``'good'``, ``'check'`` or ``'bad'`` where the summary begins with the verdict on a solve."""
    fresh: bool = True
    """False where the outputs were up to date, and nothing was written."""

    def __repr__(self) -> str:
        files = ", ".join(path.name for path in self.outputs)
        counts = f"{pluralize(len(self.notes), 'note')}, {pluralize(len(self.figures), 'figure')}"
        return f"<StepResult: {self.summary} [{files or 'no file'}; {counts}]>"

    @property
    def up_to_date(self) -> bool:
        """Whether the outputs were there, made from the same inputs and options: nothing done."""
        return not self.fresh

    def require_success(self) -> None:
        """Raise CheckFailedError, naming every failure, if there is one."""
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
