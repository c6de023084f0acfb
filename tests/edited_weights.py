"""The weights of a performance on disk, with its edits."""

from pathlib import Path

from usdface.core.assets import WeightsClip
from usdface.usdio.performance.read import PerformanceReader


def read_weights(path: Path) -> WeightsClip:
    """Read the animated weights of any USD file of one face."""
    reader = PerformanceReader(path)
    return WeightsClip(reader.names, reader.edited(), reader.first_frame, reader.rate)
