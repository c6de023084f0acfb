"""Run benchmarks and print their tables: `poe bench`, or `python -m tests.benchmarks NAME...`.

With `--quick`, benchmarks that have a short form run that."""

import sys
from importlib import import_module
from inspect import signature
from pathlib import Path


def names() -> list[str]:
    """Return every benchmark there is."""
    here = Path(__file__).parent
    return sorted(path.stem for path in here.glob("*.py") if not path.stem.startswith("_"))


def main() -> int:
    """Run the benchmarks named, or all."""
    quick = "--quick" in sys.argv
    wanted = [name for name in sys.argv[1:] if name != "--quick"] or names()
    unknown = [name for name in wanted if name not in names()]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    for name in wanted:
        print(f"## {name}\n", flush=True)
        run = import_module(f"tests.benchmarks.{name}").run
        run(**({"quick": True} if quick and "quick" in signature(run).parameters else {}))
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
