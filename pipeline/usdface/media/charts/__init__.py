"""Curves and evidence as pictures."""
