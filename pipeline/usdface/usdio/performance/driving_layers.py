"""Layers of a performance with joints, Xforms and attributes, and joining those of parts.

NAME.head.usdc and NAME.controls.usdc are sublayers of NAME.usda, stronger than its weights.
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
    """Whether a file is a sublayer of a performance."""
    layer = open_layer(performance)  # keep a reference: prims do not outlive their layer
    return relative_path(file, performance) in list(layer.subLayerPaths)


def head_layer_xforms(performance: Path) -> tuple[str, ...]:
    """Return the paths of the Xforms in a performance's head layer."""
    properties = (Sdf.Path(each) for each in _driven(performance, head_path(performance)))
    return tuple(str(each.GetPrimPath()) for each in properties if each.name == TRANSFORM)


def driving_layers(parts: Sequence[Path], beside: Callable[[Path], Path]) -> list[Path]:
    """Return the driving layers of the parts of a performance; they must drive the same.

    Since samples of joints are arrays in the order of the names in the header.

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
    """Join driving layers of parts of a performance, in the order of their frames."""
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
    """Return the names of joints and the paths of attributes that a layer drives."""
    if not opens_layer(performance, file):
        return []
    layer, driven = open_layer(file), list[str]()
    for path in paths_in(layer):
        if path.IsPropertyPath() and path.name == "joints":
            driven += map(str, layer.GetAttributeAtPath(path).default or ())
        elif path.IsPropertyPath() and path.name not in _OF_JOINTS:
            if layer.GetNumTimeSamplesForPath(path):
                driven.append(str(path))
    return driven
