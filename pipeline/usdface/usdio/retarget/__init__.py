"""Pairs, control vectors and sequences."""
