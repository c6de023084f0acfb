"""Edits of a performance, and its publishing."""
