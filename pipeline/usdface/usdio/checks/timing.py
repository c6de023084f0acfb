"""Rates and ranges: stated, the same in every layer, at whole time codes."""

import numpy as np
from pxr import Usd, UsdSkel

from usdface.usdio.checks.fault import Fault


def check_timing(stage: Usd.Stage) -> list[Fault]:
    """Look at the timing of a stage that animates weights; others are let be."""
    animated = [
        UsdSkel.Animation(prim).GetBlendShapeWeightsAttr()
        for prim in stage.TraverseAll()
        if prim.IsA(UsdSkel.Animation)
    ]
    animated = [each for each in animated if each and each.GetNumTimeSamples()]
    if not animated:
        return []
    found = [*_authored(stage), *_same_rate(stage)]
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    has_range = stage.HasAuthoredTimeCodeRange()
    for attribute in animated:
        times = np.array(attribute.GetTimeSamples())
        path = str(attribute.GetPath())
        if has_range and (times[0] < start or times[-1] > end):
            found.append(
                Fault(
                    "warning",
                    path,
                    f"samples from {times[0]:g} to {times[-1]:g} lie outside the stage's range, "
                    f"{start:g} to {end:g}: a player would not show them; author startTimeCode and "
                    "endTimeCode",
                )
            )
        odd = times[np.abs(times - np.round(times)) > 1e-6]
        if len(odd):
            found.append(
                Fault(
                    "warning",
                    path,
                    f"{len(odd)} samples lie between time codes, the first at {odd[0]:g}: was the "
                    "animation retimed by another layer's rate? Author the same rate in both",
                )
            )
    return found


def _authored(stage: Usd.Stage) -> list[Fault]:
    layer = stage.GetRootLayer()
    return [
        Fault(
            "error",
            "/",
            f"animated, but {name} is not authored: another root layer would rescale it; author "
            f"{name}",
        )
        for authored, name in (
            (layer.HasTimeCodesPerSecond(), "timeCodesPerSecond"),
            (layer.HasFramesPerSecond(), "framesPerSecond"),
            (layer.HasStartTimeCode(), "startTimeCode"),
            (layer.HasEndTimeCode(), "endTimeCode"),
        )
        if not authored
    ]


def _same_rate(stage: Usd.Stage) -> list[Fault]:
    top = stage.GetRootLayer()
    found = []
    if top.HasTimeCodesPerSecond() and top.HasFramesPerSecond():
        codes, frames = top.timeCodesPerSecond, top.framesPerSecond
        if codes != frames:
            found.append(
                Fault(
                    "warning",
                    "/",
                    f"{codes:g} time codes and {frames:g} frames per second: tools disagree on "
                    "what a frame is then; author the same number",
                )
            )
    for layer in stage.GetLayerStack(includeSessionLayers=False):
        rate = layer.timeCodesPerSecond
        if layer != top and layer.HasTimeCodesPerSecond() and rate != top.timeCodesPerSecond:
            found.append(
                Fault(
                    "warning",
                    "/",
                    f"{layer.GetDisplayName()} has {rate:g} time codes per second, "
                    f"{top.GetDisplayName()} {top.timeCodesPerSecond:g}: USD moves its samples off "
                    "the frames; author the rate of the capture in both",
                )
            )
    return found
