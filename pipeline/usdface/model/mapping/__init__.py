"""Markers to weights: trained on references, applied to takes."""
