"""From references to a mapping, and from takes to performances."""

_commands = ("describe",)

_helpers = ("baseline", "train_notes")
