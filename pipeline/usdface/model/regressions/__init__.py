"""Registry of the regressions of mappings and retargetings; one module per method."""

from usdface.core.errors import InputError
from usdface.model.regressions import (
    additive,
    face_map,
    gaussian_rbf,
    hybrid,
    kernel_cca,
    multiquadric,
    ridge,
)
from usdface.model.regressions.base import Regression

_REGRESSIONS = (
    ridge.METHOD,
    gaussian_rbf.PUBLISHED,
    gaussian_rbf.METHOD,
    face_map.METHOD,
    multiquadric.METHOD,
    kernel_cca.METHOD,
    hybrid.METHOD,
    additive.METHOD,
)

MAPPING_METHODS = {each.name: each for each in _REGRESSIONS if each.mapping_candidates is not None}
RETARGET_METHODS = {
    each.retarget_name or each.name: each for each in _REGRESSIONS if each.retarget_candidates
}

AUTO = ("face_map", "ridge", "rbf", "d06")
"""Methods that `auto` compares for a mapping; the first is the default for few pairs."""

REMOVED_METHODS = frozenset(
    (
        "regional",
        "gaussian_process",
        "inverse",
        "least_squares",
        "nnls",
        "bounded",
        "sparse",
        "ensemble",
    )
)
"""Methods of earlier versions."""


def find_method(name: str) -> Regression:
    """Return a mapping's method by name."""
    if name in REMOVED_METHODS:
        raise InputError(f"method {name} was removed in this version; use auto or face_map")
    if name not in MAPPING_METHODS:
        known = ", ".join(sorted(MAPPING_METHODS))
        raise InputError(f"no method {name!r}; choose one of auto, {known}")
    return MAPPING_METHODS[name]


def find_retarget_method(name: str) -> Regression:
    """Return a retargeting's method by name."""
    if name not in RETARGET_METHODS:
        known = ", ".join(("auto", *RETARGET_METHODS))
        raise InputError(f"no retargeting method {name!r}; choose one of {known}")
    return RETARGET_METHODS[name]
