"""Captures to cleaned takes."""
