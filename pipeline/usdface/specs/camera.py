"""How a spec names the camera that pictures are taken by."""

from typing import Annotated

from pydantic import Field

AUTO = "auto"

CameraName = Annotated[
    str,
    Field(
        pattern=r"^(auto|(/[A-Za-z_][A-Za-z0-9_]*)+)$",
        max_length=1000,
        examples=["auto", "/Shot/Cameras/main"],
    ),
]
"""``auto``, which frames the face, or the path of a camera."""
