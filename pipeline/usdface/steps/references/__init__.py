"""Reference frames: chosen, tuned, measured."""
