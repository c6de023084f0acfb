"""Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline.

The names of `__all__` are the public API. Each is imported when it is first used, so that
``import usdface`` is fast, and specs can be checked on a machine without USD. The folder of our
schemas is registered at once, as USD reads PXR_PLUGINPATH_NAME when it is first imported.
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

with contextlib.suppress(_UsdfaceError):  # raised again by readers of USD
    register_plugin_path()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'usdface' has no attribute {name!r}; it has {__all__}")
    return getattr(
        import_module("usdface.core.errors" if name == "UsdfaceError" else "usdface.api"), name
    )


def __dir__() -> list[str]:
    return sorted(__all__)
