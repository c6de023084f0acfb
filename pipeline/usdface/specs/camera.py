"""How a spec names the camera that pictures are taken by."""

from typing import Annotated

from pydantic import AfterValidator, Field

from usdface.specs.base import PRIM_PATTERN, prim_path

AUTO = "auto"

CameraName = Annotated[
    str,
    Field(
        pattern=f"^(auto|{PRIM_PATTERN})$",
        max_length=1000,
        examples=["auto", "/Shot/Cameras/main"],
    ),
    AfterValidator(prim_path),
]
"""``auto``, which frames the face, or the path of a camera."""
