"""One step per file: a spec in, files written, a report out; glue only."""
