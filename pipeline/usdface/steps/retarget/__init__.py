"""From one face to another."""

_commands = ("names", "retarget_folder")
