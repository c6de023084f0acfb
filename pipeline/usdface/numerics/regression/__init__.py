"""Regressions from example pairs, their validation, and the design of references."""
