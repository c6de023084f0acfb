"""Reference frames: chosen, tuned, measured."""

_helpers = ("images",)
