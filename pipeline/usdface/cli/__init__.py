"""Command line: arguments to spec to step; the only place that prints or exits."""

import os

# The matrices here are small: a second BLAS thread waits more than it works, and on a busy machine
# it costs four times the time. Set the variable yourself to say otherwise. It counts only before
# numpy is first imported, so it stands before all else.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from usdface.cli.app import main

__all__ = ["main"]
