"""A performer's head space, neutral face and sample of expressions, to which takes are aligned."""

import json
from dataclasses import dataclass, field, replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import References, TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.motion_space import motion_of, sampled_frames, thinned_sample
from usdface.numerics.rigid.pose_error import ExpressionMotion


@dataclass(frozen=True)
class PerformerFace:
    """Head space and neutral face of a performer."""

    marker_names: tuple[str, ...]
    rigid: tuple[str, ...]
    """`marker_names`, `rigid`: Names of all markers in order, and of those that move with the skull
    alone."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]."""
    frames: FloatArray
    """(frames, markers, 3): sample of expressions in that head space [mm]."""
    usable: BoolArray
    """(frames, markers): where `frames` is measured or repaired."""
    performer: str = ""
    session: str = ""
    """`performer`, `session`: Of the take that defines the space; empty if unknown."""
    expressions: ExpressionMotion | None = None
    """With which errors of poses are found; None if not known."""
    pairs: dict[str, tuple[IntArray, FloatArray]] = field(default_factory=dict)
    """By take, the frames of its reference pairs, and their markers without the take's offset."""


def face_of_mapping(mapping: TrainedMapping) -> PerformerFace:
    """Return the face of a mapping's training; InputError if it lacks arrays, as earlier ones."""
    frames = sampled_frames(motion_of(mapping))
    pairs = mapping.arrays.get("pair_frames", np.zeros((0, 2))).astype(np.int64)
    try:
        takes = json.loads(str(mapping.settings.get("pair_takes", "[]")))
        return PerformerFace(
            mapping.marker_names,
            mapping.rigid,
            mapping.neutral,
            frames,
            np.ones(frames.shape[:2], np.bool_),
            str(mapping.settings.get("performer", "")),
            str(mapping.settings.get("session", "")),
            ExpressionMotion.from_arrays(mapping.arrays, mapping.neutral),
            {
                take: (pairs[rows, 1], mapping.arrays["pair_markers"][rows])
                for index, take in enumerate(takes)
                if (rows := pairs[:, 0] == index).any()
            },
        )
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise InputError(
            f"the mapping's pairs do not fit its takes: {error}; train it again"
        ) from error


def face_of_references(references: References) -> PerformerFace:
    """Return the face of references, with frames of their motion space or else their pairs."""
    frames = references.markers.astype(np.float64)
    if references.motion is not None and len(references.motion.sample):
        thinned = replace(references.motion, sample=thinned_sample(references.motion))
        frames = sampled_frames(thinned)
    return PerformerFace(
        references.marker_names,
        references.rigid,
        references.neutral,
        frames,
        np.ones(frames.shape[:2], np.bool_),
        references.performer,
        references.session,
    )
