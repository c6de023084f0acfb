"""Editing and publishing of performances."""

_commands = ("list_", "validate")
