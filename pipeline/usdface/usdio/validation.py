"""Is a layer in order? USD's own validators, ours among them as the plug-in `usdio.checks`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pxr import UsdSkel, UsdValidation

from usdface.usdio.layers import open_stage, refusing_wrong_types, usd_errors_as_input_errors

Severity = Literal["error", "warning"]

_PLUGIN = "usdface.usdio.checks"

_OF_A_LAYER_ALONE = tuple(f"{_PLUGIN}:{name}" for name in ("Weights", "Curves", "Edits"))
"""What can be asked of an animation whose rig is elsewhere."""


@dataclass(frozen=True)
class Finding:
    """One thing that is not in order."""

    severity: Severity
    check: str
    """Name of the validator; ours begin with ``usdface:``."""
    where: str
    """File and, where one is to blame, prim or property."""
    message: str
    """What is wrong and how to mend it."""


@refusing_wrong_types
def validate(path: Path) -> list[Finding]:
    """Check a USD file as it composes; an empty list means that nothing was found.

    A weights layer given alone, which says all it says over a rig that is not there, is looked at
    for what its samples tell.
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
        if loose:  # USD itself passes over what is not defined
            own = registry.GetOrLoadValidatorsByName(list(_OF_A_LAYER_ALONE))
            errors += UsdValidation.ValidationContext(own).Validate(loose)
    found = [_finding(error, path) for error in errors]
    return sorted((each for each in found if each), key=lambda each: each.severity)


def _finding(error: UsdValidation.ValidationError, path: Path) -> Finding | None:
    kind = error.GetType()
    if kind == UsdValidation.ValidationErrorType.None_:
        return None
    validator = error.GetValidator()
    name = str(validator.GetMetadata().name) if validator else "usd"
    sites = [_place(site) for site in error.GetSites()] if name.startswith(_PLUGIN) else []
    return Finding(
        severity="error" if kind == UsdValidation.ValidationErrorType.Error else "warning",
        check=name.replace(_PLUGIN, "usdface", 1),
        where=" ".join([str(path), *(f"<{site}>" for site in sites if site not in ("", "/"))]),
        message=str(error.GetMessage()).strip(),
    )


def _place(site: UsdValidation.ValidationErrorSite) -> str:
    if site.IsProperty():
        return str(site.GetProperty().GetPath())
    return str(site.GetPrim().GetPath()) if site.IsPrim() else ""
