"""Pictures that are kept, and how far one may lie from them.

`python -m tests.media.baseline_pictures` draws them again: look at them before you commit them.
"""

from functools import cache
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813

from usdface.core.arrays import ByteImage
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.media.face.camera import Camera, frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.picture.image import write_image

FOLDER = Path(__file__).parent / "baselines"
SIZE = 160
MEAN_STEPS = 1.5
"""Of 255: rounding differs between processors, and rays that graze an edge hit or miss."""
TAIL_STEPS = 40.0
"""Of 255, in all but one pixel of a hundred."""

POSES = {
    "neutral": {},
    "open_smile": {"jawOpen": 0.6, "mouthSmileLeft": 0.7, "mouthSmileRight": 0.7},
    "blink_brows_down": {
        "eyeBlinkLeft": 1.0,
        "eyeBlinkRight": 1.0,
        "browDownLeft": 0.8,
        "browDownRight": 0.8,
    },
}


@cache
def _face() -> tuple[FaceRenderer, Deformer, tuple[str, ...], Camera]:
    rig = demo_rig()
    return (
        FaceRenderer(rig.meshes),
        Deformer(rig),
        rig.shapes,
        frame_rig(rig.meshes, yaw_degrees=12),
    )


def draw(name: str) -> ByteImage:
    """Draw one of `POSES`, or ``'heat'``."""
    renderer, deformer, shapes, camera = _face()
    weights = np.zeros((1, len(shapes)))
    for shape, value in POSES.get(name, {}).items():
        weights[0, shapes.index(shape)] = value
    points = deformer.points(weights)[0]
    if name != "heat":
        return renderer.render(points, camera=camera, width=SIZE, height=SIZE)
    height = np.asarray(points)[:, 1]
    return renderer.render(
        points,
        camera=camera,
        width=SIZE,
        height=SIZE,
        quality="draft",
        values=height,
        value_range=(float(height.min()), float(height.max())),
    )


NAMES = (*POSES, "heat")


def kept(name: str) -> ByteImage:
    """Return the picture that was looked at and committed."""
    return np.asarray(oiio.ImageBuf(str(FOLDER / f"{name}.png")).get_pixels(oiio.UINT8))[..., :3]


def looks_like(picture: ByteImage, other: ByteImage) -> bool:
    """Whether two pictures are the same but for rounding and grazing rays."""
    away = np.abs(picture.astype(np.int64) - other.astype(np.int64)).max(axis=2)
    return bool(away.mean() <= MEAN_STEPS and np.percentile(away, 99) <= TAIL_STEPS)


def main() -> None:
    """Draw every picture again."""
    FOLDER.mkdir(exist_ok=True)
    for name in NAMES:
        write_image(FOLDER / f"{name}.png", draw(name))


if __name__ == "__main__":
    main()
