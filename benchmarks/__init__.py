"""Benchmarks, each with a function `run`; see `__main__`."""

import os

# As in the command line, before numpy is imported: on a busy machine its threads wait for each
# other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
