"""Whether this process is a Python of its own, or one inside another program."""

import sys
from pathlib import Path


def can_start_again() -> bool:
    """Whether our interpreter can be started again, to work beside us.

    Within another program, such as a DCC, it is that program, or some Python that was found in its
    stead.
    """
    names = (sys.executable or "", *(sys.orig_argv[:1] or [""]))
    return all(Path(name).stem.lower().startswith("python") for name in names)
