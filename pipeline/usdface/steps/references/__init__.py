"""Reference frames: chosen, tuned, measured."""

_helpers = ("images", "select_notes", "weight_takes")
