"""Retargeting of weights from one character to another."""

_commands = ("retarget_folder",)
