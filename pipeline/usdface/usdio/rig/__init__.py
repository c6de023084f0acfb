"""Rigs and meshes."""
