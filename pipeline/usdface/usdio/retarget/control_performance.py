"""Writing of performances of control vectors: weights, joints and attributes over one rig.

Joints and attributes are in NAME.controls.usdc: joints on the animation of the weights, attributes
as overs on the rig's prims.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from pxr import Sdf

from usdface.core.assets import Rig
from usdface.core.controls import Controls
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path
from usdface.usdio.authoring import author_uniform
from usdface.usdio.layers import new_layer, save_layer
from usdface.usdio.performance.clips import PartsWriter
from usdface.usdio.performance.weights_layer import (
    WeightsHeader,
    WeightsWriter,
    author_layer_metadata,
)
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.retarget.controls import (
    NAMES,
    author_attribute_specs,
    author_joints,
    set_attribute_samples,
    set_joint_samples,
)

_FRAMES_PER_SAVE = 1 << 14
"""Frames between two saves, which bounds the memory."""


class ControlsLayer:
    """Appends joints and attributes to a layer."""

    def __init__(
        self,
        layer: Sdf.Layer,
        path: Path,
        header: WeightsHeader,
        rig: Rig,
        *,
        joints: tuple[str, ...],
        attributes: tuple[str, ...],
    ) -> None:
        self.layer, self._path, self._unsaved = layer, path, 0
        self._animation = header.animation
        prim = Sdf.CreatePrimInLayer(layer, self._animation)
        if joints:
            author_joints(prim, joints)
        if attributes:
            author_uniform(prim, NAMES, Sdf.ValueTypeNames.StringArray, list(attributes))
        top = Sdf.Path(header.rig_path)
        self._attributes = author_attribute_specs(layer, top, rig, attributes)

    def append(self, controls: Controls, first_frame: int) -> None:
        """Append frames of joints and attributes."""
        if controls.joints:
            set_joint_samples(self.layer, self._animation, controls, first_frame)
        set_attribute_samples(self.layer, self._attributes, controls, first_frame)
        self._unsaved += len(controls)
        if self._unsaved >= _FRAMES_PER_SAVE:
            save_layer(self.layer, self._path)
            self._unsaved = 0


class ControlsWriter:
    """Appends frames; made by `writing_control_performance`."""

    def __init__(
        self, weights: WeightsWriter | PartsWriter, others: ControlsLayer | None, first_frame: int
    ) -> None:
        self._weights, self._others = weights, others
        self.layer = others.layer if others is not None else None
        self.next_frame = first_frame

    def append(self, controls: Controls) -> None:
        """Append frames of all controls."""
        self._weights.append(controls.weights)
        if self._others is not None:
            self._others.append(controls, self.next_frame)
        self.next_frame += len(controls)


@contextlib.contextmanager
def writing_control_performance(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    *,
    joints: tuple[str, ...],
    attributes: tuple[str, ...],
    above: Sequence[Path] = (),
    provenance: Provenance | None = None,
) -> Iterator[ControlsWriter]:
    """Write a performance of any controls; the files are replaced if the block succeeds.

    Parameters
    ----------
    path : Path
        The layer to open. Its other opinions and sublayers are preserved.
    header : WeightsHeader
        Of the weights, as in `writing_performance`.
    above : sequence of Path
        As in `writing_top`.
    """
    controls_file = controls_path(path) if joints or attributes else None
    with contextlib.ExitStack() as stack:
        above = above if controls_file is None else (controls_file, *above)
        weights = stack.enter_context(
            writing_performance(path, header, rig, above=above, provenance=provenance)
        )
        others = None
        if controls_file is not None:
            layer = stack.enter_context(new_layer(controls_file, provenance))
            author_layer_metadata(layer, header, rig)
            others = ControlsLayer(
                layer, controls_file, header, rig, joints=joints, attributes=attributes
            )
        yield ControlsWriter(weights, others, header.first_frame)
