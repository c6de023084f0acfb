"""Command line: from arguments to spec to step. Only this folder prints and exits."""

import os
import sys

from usdface.core.errors import CancelledError

# A sum over more threads is rounded otherwise, and the same inputs have to give the same bytes.
# Matrices are small, too: a second thread mostly waits, and on a busy machine takes four times as
# long. Read when numpy is first imported.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    try:
        from usdface.cli.app import main as run  # which takes half a second
    except KeyboardInterrupt:
        sys.stderr.write("usdface: interrupted\n")
        sys.exit(CancelledError.exit_code)
    run(arguments)
