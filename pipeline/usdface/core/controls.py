"""Control vectors of characters, and corresponding expressions of two characters.

A control vector (**cv** in S11, Song et al. 2011, section 3) consists of BlendShape weights, joint
transforms and float attributes (deformer controls).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.text import pluralize
from usdface.numerics.motion.rotation_space import rotation_vectors, rotations_at

JOINT_WIDTH = 9
"""Coordinates of a joint: translation, rotation vector, logarithm of its scale."""

_SMALLEST_SCALE = 1e-6


@dataclass(frozen=True)
class Controls:
    """Control vectors of a character, over frames or pairs."""

    shapes: tuple[str, ...] = ()
    """BlendShape channels."""
    weights: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, shapes)"""
    joints: tuple[str, ...] = ()
    """Joint paths, in the order of the UsdSkel skeleton."""
    translations: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    """(n, joints, 3): local to the parent joint [unit of the skeleton]."""
    rotations: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 4)))
    """(n, joints, 4): unit quaternions, w first."""
    scales: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    """(n, joints, 3)"""
    attributes: tuple[str, ...] = ()
    """``PRIM.ATTRIBUTE``, the prim's path relative to the character's top prim."""
    values: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, attributes)"""

    def __len__(self) -> int:
        return len(self.weights)

    def rows(self, chosen: slice | IntArray | list[int]) -> "Controls":
        """Return some of the frames or pairs."""
        return self.mapped(lambda array: array[chosen])

    def mapped(self, change: Callable[..., FloatArray], *others: "Controls") -> "Controls":
        """Return controls whose arrays are a function of these and the corresponding others."""
        names = ("weights", "translations", "rotations", "scales", "values")
        every = (self, *others)
        arrays = {name: change(*(getattr(one, name) for one in every)) for name in names}
        return replace(self, **arrays)  # type: ignore[arg-type]

    @property
    def summary(self) -> str:
        """Numbers of shapes, joints and attributes, as text."""
        parts = [pluralize(len(self.shapes), "shape")]
        if self.joints:
            parts.append(pluralize(len(self.joints), "joint"))
        if self.attributes:
            parts.append(pluralize(len(self.attributes), "attribute"))
        return ", ".join(parts)


def shape_controls(shapes: tuple[str, ...], weights: FloatArray) -> Controls:
    """Return controls of BlendShape weights alone."""
    count = len(weights)
    return Controls(
        shapes=shapes,
        weights=weights,
        translations=np.zeros((count, 0, 3)),
        rotations=np.zeros((count, 0, 4)),
        scales=np.zeros((count, 0, 3)),
        values=np.zeros((count, 0)),
    )


@dataclass(frozen=True)
class ControlClip:
    """Controls over consecutive frames."""

    controls: Controls
    first_frame: int
    """Frame number of the first row."""
    rate: Fraction
    """Frames per second."""
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty if unknown."""

    @property
    def last_frame(self) -> int:
        """Frame number of the last row."""
        return self.first_frame + len(self.controls) - 1


@dataclass(frozen=True)
class ExpressionPairs:
    """Corresponding expressions of a source and a target; pair *i* at index *i*.

    The files of the characters are None, and the paths of their SkelRoots empty, if unknown.
    """

    names: tuple[str, ...]
    """Name of each pair, or an empty string."""
    source_shapes: tuple[str, ...]
    source: FloatArray
    """(pairs, source shapes): the paper's matrix S (eq. 1)."""
    target: Controls
    """The paper's matrix T (eq. 2)."""
    source_rig: Path | None = None
    source_prim: str = ""
    target_rig: Path | None = None
    target_prim: str = ""

    def __len__(self) -> int:
        return len(self.source)

    def rows(self, chosen: IntArray) -> "ExpressionPairs":
        """Return some of the pairs."""
        return replace(
            self,
            names=tuple(self.names[index] for index in chosen.tolist()),
            source=self.source[chosen],
            target=self.target.rows(chosen),
        )


@dataclass(frozen=True)
class RetargetScore:
    """The round-trip error of one candidate."""

    method: str
    settings: str
    """Readable."""
    cyclic_mm: float
    """Source to target to source: mean distance of the source's points [mm], or root mean square
    error of the weights without a source rig."""
    pair_error: float
    """Root mean square residual at the pairs, each control over its range."""
    overshoot: float = 0.0
    """Root mean square by which parts of the pairs' expressions move controls farther than the
    whole ones, over the motion of these."""


@dataclass(frozen=True)
class ControlSpace:
    """Coordinates of controls for regression: their names, and rotations that are zero vectors.

    Weights and attributes are used as they are. A joint's rotation becomes the rotation vector
    relative to a mean, its scale the logarithm of its size, so that any linear combination is a
    valid rotation and a scale of the same sign.
    """

    shapes: tuple[str, ...]
    joints: tuple[str, ...]
    attributes: tuple[str, ...]
    mean_rotations: FloatArray
    """(joints, 4): w first."""
    scale_signs: FloatArray
    """(joints, 3): -1 for the scales of mirrored joints, else 1."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each coordinate, for messages."""
        parts = [f"{kind}{axis}" for kind in ("translate", "rotate", "scale") for axis in "XYZ"]
        return (
            *self.shapes,
            *(f"{joint}.{each}" for joint in self.joints for each in parts),
            *self.attributes,
        )

    def encode(self, controls: Controls) -> FloatArray:
        """Return coordinates, (n, width), of controls with the names of the space."""
        scales = np.log(np.maximum(self.scale_signs * controls.scales, _SMALLEST_SCALE))
        vectors = rotation_vectors(controls.rotations, self.mean_rotations)
        joints = np.concatenate([controls.translations, vectors, scales], axis=-1)
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
            scales=self.scale_signs * np.exp(joints[..., 6:]),
            attributes=self.attributes,
            values=coordinates[:, last:],
        )


@dataclass(frozen=True)
class Retargeting(ControlSpace):
    """A trained function from source weights to a target's control vector, in its coordinates."""

    method: str
    source_shapes: tuple[str, ...]
    rest: FloatArray
    """(k,): coordinates of the control vector at the source's nearest pair to rest."""
    ranges: FloatArray
    """(k, 2): limits of the coordinates."""
    arrays: dict[str, FloatArray]
    settings: dict[str, float | int | str | bool] = field(default_factory=dict)
    scores: tuple[RetargetScore, ...] = ()
    """Candidates, best first."""
    pairs: str = ""
    """The pairs asset it was trained on."""
    target_rig: Path | None = None
    target_prim: str = ""


@dataclass(frozen=True)
class EmotionalSequence:
    """A sequence of source motion, and the target motion that replaces it, of any length."""

    label: str
    """The emotion."""
    source_shapes: tuple[str, ...]
    source: FloatArray
    """(m, source shapes): the paper's S^pair (eq. 10)."""
    target: Controls
    """The paper's T."""
    key_weights: FloatArray
    """(target frames,): weight of each key, as a share of the warp's weight; 1 unless set."""


@dataclass(frozen=True)
class SequenceMatch:
    """An occurrence of a sequence in a take."""

    sequence: Path
    """The asset."""
    label: str
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Of the take, inclusive."""
    distance: float
    """See `usdface.numerics.motion.sequence_search`."""
