"""Meshes without shapes, moved by markers."""

_helpers = ("plan", "picture", "logic_sources")
