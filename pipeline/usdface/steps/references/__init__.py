"""Reference frames: selection, tuned weights, coverage."""

_helpers = ("images", "select_notes", "weight_takes")
