"""What the layers beside a performance are called: one rule, for specs and for files."""

from pathlib import Path

LAYER_SUFFIXES = (".usda", ".usdc", ".usd")


def weights_path(performance: Path) -> Path:
    """Return where the solve of a performance is: NAME.weights.usdc beside NAME.usda."""
    return performance.with_name(f"{performance.stem}.weights.usdc")


def edits_path(performance: Path) -> Path:
    """Return where a performance's edits are: NAME.edits.usda beside NAME.usda."""
    return performance.with_name(f"{performance.stem}.edits.usda")
