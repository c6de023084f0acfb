"""One step per module: reads the files of a spec, writes files, returns a result."""
