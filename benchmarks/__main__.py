"""Run benchmarks and print their tables: `poe bench`, or `python -m benchmarks NAME...`."""

import argparse
import os
import sys
import time
import traceback
from importlib import import_module
from inspect import signature
from pathlib import Path

from benchmarks._report import Measured, kept_output, write_report


def names() -> list[str]:
    """Return the names of all benchmarks."""
    here = Path(__file__).parent
    return sorted(path.stem for path in here.glob("*.py") if not path.stem.startswith("_"))


def main() -> int:
    """Run the benchmarks named, or all."""
    parser = argparse.ArgumentParser(description="Run benchmarks and print their tables.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(names())}")
    parser.add_argument("--out", type=Path, help="keep tables and plots in this folder")
    parser.add_argument("--quick", action="store_true", help="less, where a benchmark has less")
    parser.add_argument("--full", action="store_true", help="more, where a benchmark has more")
    asked = parser.parse_args()
    unknown = [name for name in asked.names if name not in names()]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in asked.names or names():
        print(f"## {name}\n", flush=True)
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        start = time.perf_counter()
        try:
            with kept_output() as kept:
                run = import_module(f"benchmarks.{name}").run
                known = signature(run).parameters
                wanted = {"quick": asked.quick, "full": asked.full, "pictures": asked.out}
                run(**{name: said for name, said in wanted.items() if said and name in known})
        except Exception:  # run the others in any case
            traceback.print_exc()
            failed.append(name)
            continue
        print()
        if asked.out is not None:
            seconds = time.perf_counter() - start
            flags = "".join(
                f" --{flag}" for flag in ("quick", "full") if wanted[flag] and flag in known
            )
            write_report(asked.out, [Measured(name, kept.text, seconds, load, flags)])
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
