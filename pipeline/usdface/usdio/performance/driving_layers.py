"""What a performance drives beside weights: layers of its own with joints, Xforms and attributes.

NAME.head.usdc and NAME.controls.usdc lie above the weights of NAME.usda. Of parts they are joined.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from pxr import Sdf

from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import head_path
from usdface.core.text import first_few
from usdface.usdio.authoring import paths_in, sampled_properties
from usdface.usdio.layers import new_layer, open_layer, relative_path
from usdface.usdio.performance.head_layer import TRANSFORM

_OF_JOINTS = ("translations", "rotations", "scales")


def opens_layer(performance: Path, file: Path) -> bool:
    """Whether a performance opens a layer beside it."""
    layer = open_layer(performance)  # in a name: what a layer lends does not outlive it
    return relative_path(file, performance) in list(layer.subLayerPaths)


def turned_xforms(performance: Path) -> tuple[str, ...]:
    """Return the paths of the Xforms that a performance's head layer turns."""
    properties = (Sdf.Path(each) for each in _driven(performance, head_path(performance)))
    return tuple(str(each.GetPrimPath()) for each in properties if each.name == TRANSFORM)


def driving_layers(parts: Sequence[Path], beside: Callable[[Path], Path]) -> list[Path]:
    """Return the layers beside parts of a performance: all drive the same, or there are none.

    Samples of joints are arrays in the order of their names, which a joined layer has once.

    Parameters
    ----------
    beside : callable
        From a performance to the layer, such as `head_path`.
    """
    driven = [_driven(each, beside(each)) for each in parts]
    for part, names in zip(parts, driven, strict=True):
        if names != driven[0]:
            raise InputError(
                f"{part}: drives {first_few(names) or 'nothing'} where {parts[0]} drives "
                f"{first_few(driven[0]) or 'nothing'}; make it again with the same options"
            )
    return [beside(each) for each in parts] if driven and driven[0] else []


def join_driving_layers(
    path: Path,
    layers: Sequence[Path],
    *,
    last_frame: int,
    provenance: Provenance | None = None,
) -> None:
    """Join layers beside parts of a performance, in the order of their frames."""
    if not layers:
        return
    with new_layer(path, provenance) as layer:
        layer.TransferContent(open_layer(layers[0]))
        layer.endTimeCode = last_frame
        for other in map(open_layer, layers[1:]):
            _copy_samples(other, layer)


def _copy_samples(source: Sdf.Layer, target: Sdf.Layer) -> None:
    for path in sampled_properties(source):
        for time in source.ListTimeSamplesForPath(path):
            target.SetTimeSample(path, time, source.QueryTimeSample(path, time))


def _driven(performance: Path, file: Path) -> list[str]:
    """Return what a layer of a performance drives: names of joints, paths of attributes."""
    if not opens_layer(performance, file):
        return []
    layer, found = open_layer(file), list[str]()
    for path in paths_in(layer):
        if path.IsPropertyPath() and path.name == "joints":
            found += map(str, layer.GetAttributeAtPath(path).default or ())
        elif path.IsPropertyPath() and path.name not in _OF_JOINTS:
            if layer.GetNumTimeSamplesForPath(path):
                found.append(str(path))
    return found
