"""Command line: from arguments to spec to step. Only this folder prints and exits."""

import os

# Matrices are small: a second BLAS thread mostly waits, and on a busy machine takes four times as
# long. Set the variable to change this. It is read when numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from usdface.cli.app import main

__all__ = ["main"]
