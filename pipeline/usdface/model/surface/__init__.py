"""Markers to the points of any mesh."""
