"""Control vectors: all that drives a character, and pairs of expressions that tie two characters.

A control vector is what S11 (Song et al. 2011, section 3) calls **cv**: BlendShape weights, joint
transforms and any float attribute (deformer controls), side by side and each as what it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray


def _none(*shape: int) -> FloatArray:
    return np.zeros(shape)


@dataclass(frozen=True)
class Controls:
    """What drives a character, over frames or pairs."""

    shapes: tuple[str, ...] = ()
    """BlendShape channels."""
    weights: FloatArray = field(default_factory=lambda: _none(0, 0))
    """(n, shapes)"""
    joints: tuple[str, ...] = ()
    """Joint paths, as UsdSkel orders a skeleton's."""
    translations: FloatArray = field(default_factory=lambda: _none(0, 0, 3))
    """(n, joints, 3): local to the parent joint [unit of the skeleton]."""
    rotations: FloatArray = field(default_factory=lambda: _none(0, 0, 4))
    """(n, joints, 4): unit quaternions, w first."""
    scales: FloatArray = field(default_factory=lambda: _none(0, 0, 3))
    """(n, joints, 3)"""
    attributes: tuple[str, ...] = ()
    """``PRIM.ATTRIBUTE``, the prim's path taken from the character's top prim."""
    values: FloatArray = field(default_factory=lambda: _none(0, 0))
    """(n, attributes)"""

    def __len__(self) -> int:
        return len(self.weights)

    def rows(self, chosen: slice | IntArray | list[int]) -> "Controls":
        """Keep some of the frames or pairs."""
        return self.mapped(lambda array: array[chosen])

    def mapped(self, change: Callable[..., FloatArray], *others: "Controls") -> "Controls":
        """Return the controls with each array changed, as it is and as others have it."""
        names = ("weights", "translations", "rotations", "scales", "values")
        every = (self, *others)
        arrays = {name: change(*(getattr(each, name) for each in every)) for name in names}
        return replace(self, **arrays)  # type: ignore[arg-type]

    @property
    def summary(self) -> str:
        """How many of each there are, for people."""
        parts = [f"{len(self.shapes)} shapes"]
        if self.joints:
            parts.append(f"{len(self.joints)} joints")
        if self.attributes:
            parts.append(f"{len(self.attributes)} attributes")
        return ", ".join(parts)


def bare_controls(shapes: tuple[str, ...], weights: FloatArray) -> Controls:
    """Return controls that are BlendShape weights alone."""
    count = len(weights)
    return Controls(
        shapes=shapes,
        weights=weights,
        translations=_none(count, 0, 3),
        rotations=_none(count, 0, 4),
        scales=_none(count, 0, 3),
        values=_none(count, 0),
    )


@dataclass(frozen=True)
class ControlClip:
    """Controls over consecutive frames."""

    controls: Controls
    first_frame: int
    """Frame number of the first row."""

    @property
    def last_frame(self) -> int:
        """Frame number of the last row."""
        return self.first_frame + len(self.controls) - 1


@dataclass(frozen=True)
class ExpressionPairs:
    """Expressions of a source beside those of a target that mean the same; pair *i* at index *i*.

    The files of the characters are None, and the paths of their SkelRoots empty, where unknown.
    """

    names: tuple[str, ...]
    """What each pair is called; empty strings where nobody said."""
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
        """Keep some of the pairs."""
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
    """Source to target to source: mean distance of the source's points [mm]; root mean square of
    the weights where no source rig is known."""
    pair_error: float
    """Root mean square miss at the pairs themselves, each control over its range."""


@dataclass(frozen=True)
class Retargeting:
    """A trained function from source weights to a target's control vector."""

    method: str
    source_shapes: tuple[str, ...]
    shapes: tuple[str, ...]
    joints: tuple[str, ...]
    attributes: tuple[str, ...]
    """`shapes`, `joints`, `attributes`: Of the target."""
    mean_rotations: FloatArray
    """(joints, 4): where joint rotations become vectors; w first."""
    rest: FloatArray
    """(k,): coordinates of the control vector at the source's nearest pair to rest."""
    ranges: FloatArray
    """(k, 2): lowest and highest coordinate that is passed on."""
    arrays: dict[str, FloatArray]
    settings: dict[str, float | int | str | bool] = field(default_factory=dict)
    scores: tuple[RetargetScore, ...] = ()
    """What was tried, best first."""
    pairs: str = ""
    """The pairs asset it was trained on."""
    target_rig: Path | None = None
    target_prim: str = ""


@dataclass(frozen=True)
class EmotionalSequence:
    """A stretch of source motion and what the target does in its place, of any other length."""

    label: str
    """The emotion."""
    source_shapes: tuple[str, ...]
    source: FloatArray
    """(m, source shapes): the paper's S^pair (eq. 10)."""
    target: Controls
    """The paper's T, over its own frames."""
    key_weights: FloatArray
    """(target frames,): how firmly each key is asked for, as a share of the warp's weight; 1 unless
    set."""


@dataclass(frozen=True)
class SequenceMatch:
    """A place where a take holds a sequence."""

    sequence: Path
    """The asset."""
    label: str
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Of the take, inclusive."""
    distance: float
    """See `usdface.numerics.motion.sequence_search`."""
