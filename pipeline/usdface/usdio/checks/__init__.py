"""Our validators, a plug-in of UsdValidation, available to all tools that use USD's validators.

USD reads ``plugInfo.json`` in this folder and imports this module when a validator is requested.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from pxr import Sdf, Usd, UsdValidation

from usdface.usdio.checks.curves import check_curves, check_timing
from usdface.usdio.checks.fault import Fault
from usdface.usdio.checks.files import (
    check_absolute_paths,
    check_instances,
    check_missing_files,
    check_names,
    check_provenance,
    check_sides,
    check_targets,
)
from usdface.usdio.checks.weights import check_edits, check_weights

_PLUGIN = "usdface.usdio.checks"

_KINDS = {
    "error": UsdValidation.ValidationErrorType.Error,
    "warning": UsdValidation.ValidationErrorType.Warn,
}

_PRIM_CHECKS: dict[str, Callable[[Usd.Prim], Iterable[Fault]]] = {
    "Curves": check_curves,
    "Edits": check_edits,
    "Names": check_names,
    "Weights": check_weights,
}
_STAGE_CHECKS: dict[str, Callable[[Usd.Stage], Iterable[Fault]]] = {
    "AbsolutePaths": check_absolute_paths,
    "Instances": check_instances,
    "MissingFiles": check_missing_files,
    "Provenance": check_provenance,
    "Sides": check_sides,
    "Targets": check_targets,
    "Timing": check_timing,
}


def _validate(
    name: str, check: Callable[[Any], Iterable[Fault]], subject: Usd.Prim | Usd.Stage, _: object
) -> list[UsdValidation.ValidationError]:
    """Return the faults of a prim or a stage as errors of USD's validation."""
    stage = subject.GetStage() if isinstance(subject, Usd.Prim) else subject
    return [
        UsdValidation.ValidationError(
            name,
            _KINDS[fault.severity],
            [UsdValidation.ValidationErrorSite(stage, Sdf.Path(fault.path))],
            fault.message,
        )
        for fault in check(subject)
    ]


def _register() -> None:
    registry = UsdValidation.ValidationRegistry()
    for name, check in _PRIM_CHECKS.items():
        registry.RegisterPluginPrimValidator(f"{_PLUGIN}:{name}", partial(_validate, name, check))
    for name, look in _STAGE_CHECKS.items():
        registry.RegisterPluginStageValidator(f"{_PLUGIN}:{name}", partial(_validate, name, look))


_register()
