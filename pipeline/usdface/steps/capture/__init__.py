"""Captures to cleaned takes."""

_commands = ("ingest_folder",)
_helpers = ("adjust_take", "capture_audio", "merge_captures", "timecode_offset")
