"""Triangulation of polygon meshes, and geodesic distances over them."""
