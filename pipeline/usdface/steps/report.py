"""What a step says when it is done."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Report:
    """The result of a step, for people and scripts.

    Attributes
    ----------
    outputs : tuple of Path
        Files written; empty where the step only looked.
    summary : str
        One line that says what came out.
    notes : tuple of str
        What the user should know: things dropped, assumed, repaired, doubtful.
    figures : dict
        Numbers and names worth keeping, ready for JSON.
    """

    outputs: tuple[Path, ...]
    summary: str
    notes: tuple[str, ...] = ()
    figures: dict[str, object] = field(default_factory=dict)

    def as_data(self) -> dict[str, object]:
        """Return the report as plain data for ``--json``."""
        return {
            "outputs": [str(path) for path in self.outputs],
            "summary": self.summary,
            "notes": list(self.notes),
            "figures": self.figures,
        }
