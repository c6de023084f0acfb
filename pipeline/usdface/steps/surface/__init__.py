"""Meshes without shapes, animated by markers, and the logic of rigs."""

_helpers = ("plan", "picture")
