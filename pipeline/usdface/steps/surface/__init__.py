"""Meshes without shapes, moved by markers."""
