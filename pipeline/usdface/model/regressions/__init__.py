"""The regression methods by name; one file each."""

from usdface.core.errors import InputError
from usdface.model.regressions import (
    d06,
    ensemble,
    gaussian_rbf,
    hybrid,
    inverse,
    kernel_cca,
    multiquadric,
    regional,
    relevance_process,
)
from usdface.model.regressions import ridge as linear
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings

__all__ = ["AUTO", "METHODS", "Fitted", "Method", "Pairs", "Settings", "find_method"]

_METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        d06.METHOD,
        linear.METHOD,
        gaussian_rbf.METHOD,
        ensemble.METHOD,
        multiquadric.METHOD,
        kernel_cca.METHOD,
        hybrid.METHOD,
        relevance_process.METHOD,
        regional.METHOD,
        inverse.METHOD,
        *inverse.SINGLE,
    )
}

AUTO = ("ridge", "ensemble", "rbf", "d06")
"""What `auto` tries; the first is taken where pairs are too few to compare."""


def find_method(name: str) -> Method:
    """Look a method up by name.

    Raises
    ------
    InputError
        If there is none; the message lists those there are.
    """
    if name not in _METHODS:
        raise InputError(f"no method {name!r}; choose one of auto, {', '.join(sorted(_METHODS))}")
    return _METHODS[name]
