"""Error measures between performances."""
