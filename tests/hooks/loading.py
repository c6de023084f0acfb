"""Load a hook as a studio's tool does: from its file, by no package."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from tests.regenerate import REPOSITORY

HOOKS = REPOSITORY / "hooks"


def load(place: str) -> ModuleType:
    """Execute a file below hooks/ as a module of its own."""
    path: Path = HOOKS / place
    spec = importlib.util.spec_from_file_location(f"hook_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
