"""Parts of the takes that benchmarks use."""

from usdface.core.assets import Markers, Take, WeightsClip
from usdface.model.selection.baseline import PerformerMarkers


def markers_of(take: Take) -> Markers:
    if take.markers is None:
        raise SystemExit(f"{take.name}: has no markers, which this benchmark needs")
    return take.markers


def performer_of(take: Take) -> PerformerMarkers:
    """Return a take's markers, and its neutral frame, as the blendshape equation needs them."""
    markers = markers_of(take)
    return PerformerMarkers(
        neutral=markers.positions[markers.neutral_frame - take.first_frame].astype(float),
        positions=markers.positions,
        visible=markers.visible,
        rigid=tuple(markers.names.index(name) for name in markers.rigid),
        labels=markers.names,
    )


def weights_of(take: Take) -> WeightsClip:
    if take.source is None:
        raise SystemExit(f"{take.name}: has no weights, which this benchmark needs")
    return take.source


def channel_of(shape: str) -> str:
    """Return a shape's name as of a phone's channel, in lower case: ``eyeBlink_L``."""
    return shape.lower().replace("_l", "left").replace("_r", "right")
