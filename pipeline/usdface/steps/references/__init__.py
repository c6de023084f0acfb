"""Reference frames: chosen, tuned, measured."""

_helpers = ("images", "tuning_guard")
