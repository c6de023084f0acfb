"""`openjd run`, as a process that has started by the time its bundle is written."""

import gc
import json
import sys


def main() -> None:
    """Run the template that standard input names, in JSON; nothing, if it ends without a word."""
    # What is imported here stays to the end: looking for garbage in it, now and when the process
    # ends, takes as long as the rest of starting and ending.
    gc.disable()
    from openjd.cli import main as openjd  # takes a while, in which Ctrl+C is no fault

    gc.freeze()
    gc.enable()
    told = sys.stdin.read()
    if told:
        openjd(["run", json.loads(told)])


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(3)
