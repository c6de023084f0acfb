"""Deformation of any mesh by markers."""
