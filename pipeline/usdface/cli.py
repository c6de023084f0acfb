"""Command line: arguments to spec to step; the only place that prints or exits."""
