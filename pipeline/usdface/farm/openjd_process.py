"""`openjd run`, as a process that has started by the time its bundle is written."""

import json
import sys


def main() -> None:
    """Run the template that standard input names, in JSON; nothing, if it ends without a word."""
    from openjd.cli import main as openjd  # takes a while, in which Ctrl+C is no fault

    told = sys.stdin.read()
    if told:
        openjd(["run", json.loads(told)])


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(3)
