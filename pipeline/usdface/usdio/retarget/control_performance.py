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
    NO_FIGURES,
    SolveFigures,
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


class ControlsWriter:
    """Appends frames; made by `writing_control_performance`.

    `layer`: of joints and attributes, at `path`; None if there are none.
    """

    def __init__(
        self,
        weights: WeightsWriter | PartsWriter,
        header: WeightsHeader,
        layer: Sdf.Layer | None,
        path: Path,
        attributes: list[Sdf.Path],
    ) -> None:
        self._weights, self.layer, self._path, self._unsaved = weights, layer, path, 0
        self._animation, self._attributes = header.animation, attributes
        self.next_frame = header.first_frame

    def append(self, controls: Controls, figures: SolveFigures = NO_FIGURES) -> None:
        """Append frames of all controls."""
        self._weights.append(controls.weights, figures)
        if self.layer is not None:
            if controls.joints:
                set_joint_samples(self.layer, self._animation, controls, self.next_frame)
            set_attribute_samples(self.layer, self._attributes, controls, self.next_frame)
            self._unsaved += len(controls)
            if self._unsaved >= _FRAMES_PER_SAVE:
                save_layer(self.layer, self._path)
                self._unsaved = 0
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
    """Write a performance of any controls, as `writing_performance` does of weights."""
    controls_file, layer, authored = controls_path(path), None, list[Sdf.Path]()
    with contextlib.ExitStack() as stack:
        above = (controls_file, *above) if joints or attributes else above
        weights = stack.enter_context(
            writing_performance(path, header, rig, above=above, provenance=provenance)
        )
        if joints or attributes:
            layer = stack.enter_context(new_layer(controls_file, provenance))
            author_layer_metadata(layer, header, rig)
            prim = Sdf.CreatePrimInLayer(layer, header.animation)
            if joints:
                author_joints(prim, joints)
            if attributes:
                author_uniform(prim, NAMES, Sdf.ValueTypeNames.StringArray, list(attributes))
            authored = author_attribute_specs(layer, Sdf.Path(header.rig_path), rig, attributes)
        yield ControlsWriter(weights, header, layer, controls_file, authored)
