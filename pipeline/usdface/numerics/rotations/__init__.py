"""Rotations as rotations: means, differences and regressions on their own curved space."""
