"""Checks of the takes that benchmarks use."""

from usdface.core.assets import Markers, Take, WeightsClip


def markers_of(take: Take) -> Markers:
    if take.markers is None:
        raise SystemExit(f"{take.name}: has no markers, which this benchmark needs")
    return take.markers


def weights_of(take: Take) -> WeightsClip:
    if take.source is None:
        raise SystemExit(f"{take.name}: has no weights, which this benchmark needs")
    return take.source
