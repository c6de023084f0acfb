"""Is a layer in order? USD's own validators, and what they do not look at."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pxr import Usd, UsdSkel, UsdValidation

from usdface.usdio.layers import open_layer, open_stage, usd_errors_as_input_errors

Severity = Literal["error", "warning"]

LARGEST_WEIGHT = 10.0
"""Weights may pass 1, but none that an animator means is this far beyond."""


@dataclass(frozen=True)
class Finding:
    """One thing that is not in order.

    Attributes
    ----------
    severity : {'error', 'warning'}
    check : str
        Name of the validator.
    where : str
        File and prim.
    message : str
        What is wrong and how to mend it.
    """

    severity: Severity
    check: str
    where: str
    message: str


def validate(path: Path) -> list[Finding]:
    """Check a USD file as it composes; an empty list means that nothing was found.

    Raises
    ------
    InputError
        If the file cannot be opened at all.
    """
    stage = open_stage(path)
    found = list(_usd_findings(stage, path))
    found += _check_timing(stage, path)
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Animation):
            for check in _ANIMATION_CHECKS:
                found += check(prim, path)
    return found


def _usd_findings(stage: Usd.Stage, path: Path) -> Iterator[Finding]:
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    with usd_errors_as_input_errors(path, "validating it"):
        errors = context.Validate(stage)
    for error in errors:
        kind = error.GetType()
        if kind == UsdValidation.ValidationErrorType.None_:
            continue
        severity: Severity = (
            "error" if kind == UsdValidation.ValidationErrorType.Error else "warning"
        )
        validator = error.GetValidator()
        name = str(validator.GetMetadata().name) if validator else "usd"
        yield Finding(severity, name, str(path), str(error.GetMessage()).strip())


def _check_timing(stage: Usd.Stage, path: Path) -> list[Finding]:
    layer = open_layer(path)
    found = []
    animated = any(
        prim.IsA(UsdSkel.Animation)
        and UsdSkel.Animation(prim).GetBlendShapeWeightsAttr().GetNumTimeSamples()
        for prim in stage.Traverse()
    )
    if not animated:
        return []
    for authored, name in (
        (layer.HasTimeCodesPerSecond(), "timeCodesPerSecond"),
        (layer.HasFramesPerSecond(), "framesPerSecond"),
        (layer.HasStartTimeCode(), "startTimeCode"),
        (layer.HasEndTimeCode(), "endTimeCode"),
    ):
        if not authored:
            found.append(
                Finding(
                    "error",
                    "usdface:Timing",
                    str(path),
                    f"animated, but {name} is not authored: another root layer would rescale it; "
                    f"author {name}",
                )
            )
    return found


def _check_weights(prim: Usd.Prim, path: Path) -> list[Finding]:
    """Look at the count and the values of every sample."""
    animation = UsdSkel.Animation(prim)
    names = animation.GetBlendShapesAttr().Get() or []
    attribute = animation.GetBlendShapeWeightsAttr()
    where = f"{path} <{attribute.GetPath()}>"
    found = []
    if len(set(names)) < len(names):
        found.append(
            Finding("error", "usdface:Names", where, "a shape is named twice; name each once")
        )
    for time in attribute.GetTimeSamples():
        weights = np.asarray(attribute.Get(time))
        fault = ""
        if len(weights) != len(names):
            fault = f"{len(weights)} weights for {len(names)} shapes; write one per shape"
        elif not np.isfinite(weights).all():
            fault = f"{names[int(np.argmin(np.isfinite(weights)))]} is not finite; map again"
        elif len(weights) and np.abs(weights).max() > LARGEST_WEIGHT:
            worst = int(np.abs(weights).argmax())
            fault = f"{names[worst]} is {weights[worst]:g}; weights are about 0 to 1"
        if fault:
            found.append(Finding("error", "usdface:Weights", f"{where} time code {time:g}", fault))
            break
    return found


def _check_names(prim: Usd.Prim, path: Path) -> list[Finding]:
    """Find shapes that no mesh has: they move nothing, whatever their weight."""
    names = set(UsdSkel.Animation(prim).GetBlendShapesAttr().Get() or [])
    on_meshes: set[str] = set()
    followers = 0
    for mesh in prim.GetStage().Traverse():
        binding = UsdSkel.BindingAPI(mesh)
        if mesh.IsA(UsdSkel.Skeleton):
            followers += prim.GetPath() in binding.GetAnimationSourceRel().GetTargets()
        on_meshes.update(binding.GetBlendShapesAttr().Get() or [])
    where = f"{path} <{prim.GetPath()}>"
    recorded = prim.GetParent().HasAPI("FaceTakeAPI")  # a take's own weights drive nothing yet
    if recorded:
        return []
    found = []
    if names and not followers:
        found.append(
            Finding(
                "warning",
                "usdface:Orphaned",
                where,
                "no skeleton follows this animation; point skel:animationSource at it",
            )
        )
    missing = sorted(map(str, names - on_meshes))
    if missing and on_meshes:
        found.append(
            Finding(
                "error",
                "usdface:Names",
                where,
                f"{len(missing)} shapes are on no mesh: {', '.join(missing[:5])}; is it this "
                "rig's animation?",
            )
        )
    return found


_ANIMATION_CHECKS: tuple[Callable[[Usd.Prim, Path], list[Finding]], ...] = (
    _check_weights,
    _check_names,
)
