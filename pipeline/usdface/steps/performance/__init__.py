"""References to a mapping, takes to performances."""

_helpers = ("predict_blocks",)
_commands = ("describe",)
