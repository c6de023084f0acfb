"""Captured samples mended: swaps, strays, gaps and noise."""
