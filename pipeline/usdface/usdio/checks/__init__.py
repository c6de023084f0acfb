"""Our validators, a plug-in of UsdValidation, available to all tools that use USD's validators.

USD reads ``plugInfo.json`` in this folder and imports this module when a validator is requested.
"""

from collections.abc import Callable, Iterable

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
    "Timing": check_timing,
}


def _errors(
    name: str, stage: Usd.Stage, faults: Iterable[Fault]
) -> list[UsdValidation.ValidationError]:
    return [
        UsdValidation.ValidationError(
            name,
            _KINDS[fault.severity],
            [UsdValidation.ValidationErrorSite(stage, Sdf.Path(fault.path))],
            fault.message,
        )
        for fault in faults
    ]


def _register() -> None:
    registry = UsdValidation.ValidationRegistry()
    for name, check in _PRIM_CHECKS.items():

        def look_at_prim(
            prim: Usd.Prim,
            _: object,
            *,
            name: str = name,
            check: Callable[[Usd.Prim], Iterable[Fault]] = check,
        ) -> list[UsdValidation.ValidationError]:
            return _errors(name, prim.GetStage(), check(prim))

        registry.RegisterPluginPrimValidator(f"{_PLUGIN}:{name}", look_at_prim)
    for name, look in _STAGE_CHECKS.items():

        def look_at_stage(
            stage: Usd.Stage,
            _: object,
            *,
            name: str = name,
            check: Callable[[Usd.Stage], Iterable[Fault]] = look,
        ) -> list[UsdValidation.ValidationError]:
            return _errors(name, stage, check(stage))

        registry.RegisterPluginStageValidator(f"{_PLUGIN}:{name}", look_at_stage)


_register()
