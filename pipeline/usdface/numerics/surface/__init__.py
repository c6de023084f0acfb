"""Distances over the surface of a mesh, however many islands it has."""
