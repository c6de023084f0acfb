"""From captures to cleaned takes."""

_commands = ("ingest_folder",)
_helpers = ("clean_notes", "merge_captures", "track_notes", "track_pictures", "track_views")
