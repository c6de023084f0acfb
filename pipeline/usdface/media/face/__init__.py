"""Faces and markers, drawn."""
