"""Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline.

Ten names are promised to scripts; each is imported when it is first used, so that
``import usdface`` costs nothing and a machine without USD can still check specs. Where USD finds
our schemas is said at once: it looks when it starts, which may be in a script's next line.
"""

import contextlib
from importlib import import_module
from typing import TYPE_CHECKING, Any

from usdface.core.errors import UsdfaceError as _UsdfaceError
from usdface.core.plugin_path import register_plugin_path
from usdface.core.version import __version__

if TYPE_CHECKING:
    from usdface.api import (
        check_job,
        read_mapping,
        read_performance,
        read_references,
        read_rig,
        read_take,
        run_job,
        run_step,
        validate,
    )
    from usdface.core.errors import UsdfaceError

__all__ = [
    "UsdfaceError",
    "__version__",
    "check_job",
    "read_mapping",
    "read_performance",
    "read_references",
    "read_rig",
    "read_take",
    "run_job",
    "run_step",
    "validate",
]

with contextlib.suppress(_UsdfaceError):  # what reads USD says it again, where somebody listens
    register_plugin_path()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'usdface' has no attribute {name!r}; it has {__all__}")
    return getattr(
        import_module("usdface.core.errors" if name == "UsdfaceError" else "usdface.api"), name
    )


def __dir__() -> list[str]:
    return sorted(__all__)
