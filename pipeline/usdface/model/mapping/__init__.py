"""Mapping from markers to weights: training on references, prediction for takes."""
