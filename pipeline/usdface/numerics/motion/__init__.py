"""Curves over time: edits, warps, rotations, sequences."""
