"""Charts of curves, coverage and errors."""
