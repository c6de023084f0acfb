"""Time samples of a layer whose rate changes: the same seconds, by other time codes."""

from pxr import Sdf


def retime_layer(layer: Sdf.Layer, rate: float) -> None:
    """Give a layer another rate, and move its samples so that they stay where they are in time.

    Parameters
    ----------
    layer : Sdf.Layer
    rate : float
        Time codes per second.
    """
    factor = rate / layer.timeCodesPerSecond
    layer.timeCodesPerSecond = rate
    if factor == 1:
        return
    sampled: list[Sdf.Path] = []

    def look(path: Sdf.Path) -> None:
        if path.IsPropertyPath() and layer.GetNumTimeSamplesForPath(path):
            sampled.append(path)

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    for path in sampled:
        times = layer.ListTimeSamplesForPath(path)
        values = [layer.QueryTimeSample(path, time) for time in times]
        for time in times:
            layer.EraseTimeSample(path, time)
        for time, value in zip(times, values, strict=True):
            layer.SetTimeSample(path, time * factor, value)
