"""Set up an environment beside this file and run one thing in it. Needs only Python and pip.

    python3 develop.py demo     make the built-in demo in ./demo
    python3 develop.py check    format, lint, types, imports and tests, as CI runs them
    python3 develop.py shell    only set up, and say how to use it

What is installed is pinned, with hashes, in constraints.txt.
"""

import argparse
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
CONSTRAINTS = ROOT / "constraints.txt"
OLDEST_PYTHON = (3, 11)


def main() -> int:
    """Set up the environment if need be, then do what was asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", choices=["demo", "check", "shell"])
    task = parser.parse_args().task
    if sys.version_info < OLDEST_PYTHON:
        found = ".".join(map(str, sys.version_info[:3]))
        print(f"Python {found} is too old; run this with Python 3.11 or newer.", file=sys.stderr)
        return 2
    programs = set_up()
    if task == "demo":
        code = run(programs / "usdface", "demo", "--out", "demo")
        print(f"usdface is {programs / 'usdface'}")
        return code
    if task == "check":
        return run(programs / "poe", "check")
    print(f"Ready. Use {programs / 'usdface'} --help")
    return 0


def set_up() -> Path:
    """Make the environment match constraints.txt; return the folder of its programs."""
    programs = ENVIRONMENT / ("Scripts" if os.name == "nt" else "bin")
    python = programs / "python"
    mark = ENVIRONMENT / "installed.txt"
    wanted = CONSTRAINTS.read_text(encoding="utf-8")
    if mark.is_file() and mark.read_text(encoding="utf-8") == wanted:
        return programs
    print(f"Setting up {ENVIRONMENT} ...", flush=True)
    venv.create(ENVIRONMENT, with_pip=True, clear=True)
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    steps = (
        [*pip, "--require-hashes", "-r", CONSTRAINTS],
        # The build backend is pinned above, so nothing else is fetched to build ourselves.
        [*pip, "--no-deps", "--no-build-isolation", "--editable", ROOT],
    )
    for step in steps:
        if run(*step):
            sys.exit(f"setting up failed at: {' '.join(map(str, step))}")
    mark.write_text(wanted, encoding="utf-8")
    return programs


def run(*command: str | Path) -> int:
    """Run a program with the environment's own programs first on the path."""
    environment = dict(os.environ)
    programs = ENVIRONMENT / ("Scripts" if os.name == "nt" else "bin")
    environment["PATH"] = os.pathsep.join(
        filter(None, (str(programs), environment.get("PATH", "")))
    )
    return subprocess.run(
        list(map(str, command)), cwd=ROOT, env=environment, check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
