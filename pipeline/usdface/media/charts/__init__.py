"""Charts of curves, coverage, errors and repairs."""
