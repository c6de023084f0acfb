"""Reference frames: chosen, tuned, measured."""

_helpers = ("images", "performance_inputs", "select_notes", "weight_takes")
