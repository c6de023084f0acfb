"""Validation of layers by USD's validators and ours, the plug-in `usdio.checks`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pxr import UsdSkel, UsdValidation

from usdface.usdio.layers import open_stage, refusing_wrong_types, usd_errors_as_input_errors

Severity = Literal["error", "warning"]

_PLUGIN = "usdface.usdio.checks"

_OF_A_LAYER_ALONE = tuple(f"{_PLUGIN}:{name}" for name in ("Weights", "Curves", "Edits"))
"""Validators of an animation without its rig."""


@dataclass(frozen=True)
class Finding:
    """A fault of a layer."""

    severity: Severity
    check: str
    """Name of the validator; ours begin with ``usdface:``."""
    where: str
    """File and, if known, prim or property."""
    message: str
    """The fault and its remedy."""


@refusing_wrong_types
def validate(path: Path) -> list[Finding]:
    """Return the faults of a USD file as it composes.

    Of a weights layer without its rig, whose prims are overs, only the samples are checked.
    """
    stage = open_stage(path)
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    loose = [
        prim
        for prim in stage.TraverseAll()
        if prim.IsA(UsdSkel.Animation) and prim.IsActive() and not prim.IsDefined()
    ]
    with usd_errors_as_input_errors(path, "validating it"):
        errors = list(context.Validate(stage))
        if loose:  # USD skips undefined prims
            validators = registry.GetOrLoadValidatorsByName(list(_OF_A_LAYER_ALONE))
            errors += UsdValidation.ValidationContext(validators).Validate(loose)
    findings = [finding for error in errors if (finding := _finding(error, path))]
    return sorted(findings, key=lambda finding: finding.severity)


def _finding(error: UsdValidation.ValidationError, path: Path) -> Finding | None:
    kind = error.GetType()
    if kind == UsdValidation.ValidationErrorType.None_:
        return None
    validator = error.GetValidator()
    name = str(validator.GetMetadata().name) if validator else "usd"
    sites = [_site_path(site) for site in error.GetSites()] if name.startswith(_PLUGIN) else []
    return Finding(
        severity="error" if kind == UsdValidation.ValidationErrorType.Error else "warning",
        check=name.replace(_PLUGIN, "usdface", 1),
        where=" ".join([str(path), *(f"<{site}>" for site in sites if site not in ("", "/"))]),
        message=str(error.GetMessage()).strip(),
    )


def _site_path(site: UsdValidation.ValidationErrorSite) -> str:
    if site.IsProperty():
        return str(site.GetProperty().GetPath())
    return str(site.GetPrim().GetPath()) if site.IsPrim() else ""
