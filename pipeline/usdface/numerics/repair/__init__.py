"""Captured markers repaired: swapped labels, outliers, gaps and noise."""
