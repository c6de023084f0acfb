"""Edits of a performance, and its publishing."""

_commands = ("list_", "validate")
