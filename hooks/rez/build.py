"""Rez: install usdface and its dependencies into the package being built; run by package.py."""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def main():
    """Install by pip if rez installs; return pip's exit code."""
    if os.environ.get("REZ_BUILD_INSTALL") != "1":
        sys.stdout.write("nothing to build; `rez build --install` installs usdface\n")
        return 0
    checkout = Path(os.environ["REZ_BUILD_SOURCE_PATH"]).parents[1]
    target = Path(os.environ["REZ_BUILD_INSTALL_PATH"], "python")
    if target.exists():
        shutil.rmtree(target)  # pip would keep existing files, with a warning only
    pip = [sys.executable, "-m", "pip", "install", "--no-compile", "--target"]
    return subprocess.run([*pip, str(target), str(checkout)], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
