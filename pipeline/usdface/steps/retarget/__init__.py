"""Retargeting of weights from one character to another."""

_commands = ("names", "retarget_folder")
_helpers = ("sequence_rate",)
