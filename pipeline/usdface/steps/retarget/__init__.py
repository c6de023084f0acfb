"""From one face to another."""

_commands = ("names", "retarget_folder")
_helpers = ("sequence_rate",)
