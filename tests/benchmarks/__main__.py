"""Run benchmarks and print their tables: `poe bench`, or `python -m tests.benchmarks NAME...`."""

import sys
from importlib import import_module
from pathlib import Path


def names() -> list[str]:
    """Return every benchmark there is."""
    here = Path(__file__).parent
    return sorted(path.stem for path in here.glob("*.py") if not path.stem.startswith("_"))


def main() -> int:
    """Run the benchmarks named, or all."""
    wanted = sys.argv[1:] or names()
    unknown = [name for name in wanted if name not in names()]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    for name in wanted:
        print(f"## {name}\n", flush=True)
        import_module(f"tests.benchmarks.{name}").run()
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
