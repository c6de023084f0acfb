"""Reference frames: selection, tuned weights, coverage."""

_helpers = ("images", "performance_inputs", "select_notes", "weight_takes")
