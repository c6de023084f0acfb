"""Named poses, in one file next to the references, which can be copied to other assets."""

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
"""About a thousand poses of a thousand shapes."""

PoseName = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=80)]
PoseWeights = Annotated[
    dict[str, Annotated[float, Field(ge=-100.0, le=100.0)]], Field(max_length=10_000)
]


class SavedPoses(BaseModel):
    """The file of poses."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    usdface_poses: Literal[1] = 1
    poses: Annotated[dict[PoseName, PoseWeights], Field(max_length=10_000)] = {}
    """Weights by names of pose and shape; 0 if missing."""


def read_poses(path: Path) -> SavedPoses:
    """Return the saved poses; empty if there is no file."""
    check_may_open(path)
    if not path.exists():
        return SavedPoses()
    try:
        return SavedPoses.model_validate(read_json(path, LARGEST_POSES_BYTES))
    except ValidationError as error:
        raise InputError(f"{path}: {validation_messages(error, Spec)}") from error


def save_pose(path: Path, name: str, weights: dict[str, float] | None) -> SavedPoses:
    """Save a pose, or remove it if `weights` is None; return all poses.

    `InputError` if the file is damaged or cannot be written; it is then unchanged.
    """
    poses = {key: value for key, value in read_poses(path).poses.items() if key != name}
    if weights is not None:
        poses[name] = {shape: value for shape, value in weights.items() if value}
    saved = SavedPoses(poses=dict(sorted(poses.items())))
    write_text(path, json_text(saved.model_dump()))
    return saved
