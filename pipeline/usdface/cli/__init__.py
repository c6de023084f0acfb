"""Command line: arguments to spec to step; the only place that prints or exits."""

from usdface.cli.app import main

__all__ = ["main"]
