"""Reference frames: chosen, tuned, measured."""

_helpers = ("images", "weight_takes")
