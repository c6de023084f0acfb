"""Poses saved under a name: one file beside the references, which other assets can use."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.replacing import write_text
from usdface.core.text import json_text, read_json
from usdface.specs.base import Spec
from usdface.specs.reading import validation_messages

LARGEST_POSES_BYTES = 16 << 20
"""A thousand poses of a thousand shapes are as large."""

PoseName = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=80)]
PoseWeights = Annotated[
    dict[str, Annotated[float, Field(ge=-100.0, le=100.0)]], Field(max_length=10_000)
]


class SavedPoses(BaseModel):
    """The file of poses."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    usdface_poses: Literal[1] = 1
    poses: Annotated[dict[PoseName, PoseWeights], Field(max_length=10_000)] = {}
    """Weights by name of the pose and of the shape; a shape that is not there is at 0."""


def read_poses(path: Path) -> SavedPoses:
    """Read saved poses; none where there is no file."""
    check_may_open(path)
    if not path.exists():
        return SavedPoses()
    try:
        return SavedPoses.model_validate(read_json(path, LARGEST_POSES_BYTES))
    except ValidationError as error:
        raise InputError(f"{path}: {validation_messages(error, Spec)}") from error


def save_pose(path: Path, name: str, weights: dict[str, float] | None) -> SavedPoses:
    """Save a pose, or remove it where `weights` is None; return all there are then.

    Raises
    ------
    InputError
        If the file is damaged, or cannot be written; it stays as it is.
    """
    poses = {key: value for key, value in read_poses(path).poses.items() if key != name}
    if weights is not None:
        poses[name] = {shape: value for shape, value in weights.items() if value}
    saved = SavedPoses(poses=dict(sorted(poses.items())))
    write_text(path, json_text(saved.model_dump()))
    return saved
