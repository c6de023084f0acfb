"""Control vectors as coordinates that regressions may add up, and back.

Weights and attributes are numbers as they are. A joint's rotation is the rotation vector from the
mean over the pairs, its scale the logarithm: what a regression adds up there is a rotation and a
positive scale again, whatever comes out.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.controls import Controls
from usdface.numerics.motion.rotation_space import (
    mean_rotation,
    rotation_vectors,
    rotations_at,
)

JOINT_WIDTH = 9
"""Coordinates of a joint: translation, rotation vector, logarithm of its scale."""

_SMALLEST_SCALE = 1e-6


@dataclass(frozen=True)
class ControlSpace:
    """Which controls there are, and where rotations are flattened."""

    shapes: tuple[str, ...]
    joints: tuple[str, ...]
    attributes: tuple[str, ...]
    mean_rotations: FloatArray
    """(joints, 4): w first."""

    @property
    def width(self) -> int:
        """Number of coordinates."""
        return len(self.shapes) + JOINT_WIDTH * len(self.joints) + len(self.attributes)

    @property
    def names(self) -> tuple[str, ...]:
        """One readable name per coordinate."""
        parts = [f"{kind}{axis}" for kind in ("translate", "rotate", "scale") for axis in "XYZ"]
        return (
            *self.shapes,
            *(f"{joint}.{each}" for joint in self.joints for each in parts),
            *self.attributes,
        )

    def encode(self, controls: Controls) -> FloatArray:
        """Return coordinates: (n, width) float array.

        Raises
        ------
        ValueError
            If the controls are others than the space's, or in another order.
        """
        given = (controls.shapes, controls.joints, controls.attributes)
        if given != (self.shapes, self.joints, self.attributes):
            raise ValueError("these controls are not those of the space")
        scales = np.log(np.maximum(controls.scales, _SMALLEST_SCALE))
        turned = rotation_vectors(controls.rotations, self.mean_rotations)
        joints = np.concatenate([controls.translations, turned, scales], axis=-1)
        count = len(controls)
        return np.concatenate(
            [controls.weights, joints.reshape(count, -1), controls.values], axis=1
        )

    def decode(self, coordinates: FloatArray) -> Controls:
        """Return the controls at coordinates: (n, width) float array."""
        count, first = len(coordinates), len(self.shapes)
        last = first + JOINT_WIDTH * len(self.joints)
        joints = coordinates[:, first:last].reshape(count, len(self.joints), JOINT_WIDTH)
        return Controls(
            shapes=self.shapes,
            weights=coordinates[:, :first],
            joints=self.joints,
            translations=joints[..., :3],
            rotations=rotations_at(joints[..., 3:6], self.mean_rotations),
            scales=np.exp(joints[..., 6:]),
            attributes=self.attributes,
            values=coordinates[:, last:],
        )


def control_space(controls: Controls) -> ControlSpace:
    """Return the space of some controls, flattened about the mean of their rotations."""
    return ControlSpace(
        controls.shapes, controls.joints, controls.attributes, mean_rotation(controls.rotations)
    )
