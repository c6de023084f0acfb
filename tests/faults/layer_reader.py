"""Readers of layers in a process of their own, bounded in memory and time.

USD reads binary layers in C++: damage may end the process, or hold it for ever, and both must be
seen by a test that goes on.

`python -m tests.faults.layer_reader` answers each file that it is told with one line.
"""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

from tests.faults.child_reader import ChildReader, bound_memory, escaped

UNGUARDED = "--unguarded"


class LayerReader(ChildReader):
    """Asks this module, run as a process.

    Parameters
    ----------
    scratch : Path
        Where USD may leave its notes on a process that it ends.
    guarded : bool
        False leaves out what usdface looks at before USD opens a layer.
    """

    def __init__(self, scratch: Path, *, guarded: bool = True) -> None:
        super().__init__(
            "tests.faults.layer_reader",
            options=() if guarded else (UNGUARDED,),
            environment={"PXR_WORK_THREAD_LIMIT": "1", "TMPDIR": str(scratch)},
            seconds=60.0,
        )


def _answer(read: Callable[[Path], object], opened: Path) -> str:
    from usdface.core.errors import InputError

    try:
        read(opened)
    except InputError as error:
        return f"{'refused' if str(opened.parent) in str(error) else 'unnamed'}: {error}"
    except BaseException as error:  # this is what a test looks for
        return escaped(error)
    return "read"


def main() -> None:
    """Answer every line."""
    from tests.faults.layer_readers import READERS_BY_NAME
    from usdface.usdio import layers

    if UNGUARDED in sys.argv:
        vars(layers).update(check_crate=lambda path: None, check_reached=lambda layer: [layer])
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    bound_memory()
    for line in sys.stdin:
        reader, opened = json.loads(line)
        told = _answer(READERS_BY_NAME[reader], Path(opened))
        print(" ".join(told.split())[:500], flush=True, file=answers)


if __name__ == "__main__":
    main()
