"""References to a mapping, takes to performances."""

_commands = ("describe",)

_helpers = ("baseline",)
