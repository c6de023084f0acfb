"""Benchmarks, each with a function `run`; see `__main__`."""

import os

# As the command line does, and before numpy starts: on a busy machine its threads wait for each
# other for ever.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
