"""A target small enough to read in a test: three shapes, three joints, two deformer attributes."""

from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from tests.usdio.small_rig import small_rig
from usdface.core.assets import Rig
from usdface.core.controls import Controls
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.retarget.control_performance import writing_control_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

JOINTS = ("head", "head/ear_L", "head/ear_R")
ATTRIBUTES = ("rig/lattice.dfm:squash", "rig/lattice.dfm:curl")
RATE = Fraction(24)


def write_human(path: Path) -> Rig:
    """A source: the small rig as it is."""
    write_rig(path, small_rig("/Human"))
    return read_rig(path)


def write_creature(path: Path) -> Rig:
    """A target: the small rig with joints and deformer attributes."""
    write_rig(path, small_rig("/Beast"))
    stage = Usd.Stage.Open(str(path))
    skeleton = UsdSkel.Skeleton.Get(stage, "/Beast/rig/skeleton")
    rest = [Gf.Matrix4d(1)] + [Gf.Matrix4d().SetTranslate(Gf.Vec3d(x, 2, 0)) for x in (3, -3)]
    skeleton.GetJointsAttr().Set(list(JOINTS))
    skeleton.GetBindTransformsAttr().Set(rest)
    skeleton.GetRestTransformsAttr().Set(rest)
    lattice = UsdGeom.Scope.Define(stage, "/Beast/rig/lattice").GetPrim()
    lattice.CreateAttribute("dfm:squash", Sdf.ValueTypeNames.Float).Set(0.25)
    lattice.CreateAttribute("dfm:curl", Sdf.ValueTypeNames.Double).Set(0.0)
    lattice.CreateAttribute("dfm:name", Sdf.ValueTypeNames.String).Set("lattice")
    lattice.CreateAttribute("dfm:axis", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0, 1, 0))
    stage.GetRootLayer().Save()
    return read_rig(path)


def creature_acts(source: np.ndarray) -> Controls:
    """What the creature does for the human's jawOpen, eyeBlink and smile: bent, and with ears."""
    jaw, blink, smile = source.T
    turns = np.zeros((len(source), 3, 3))
    turns[:, 1, 2] = 1.2 * smile - 0.8 * blink
    turns[:, 2, 2] = -1.2 * smile + 0.8 * blink
    places = np.zeros((len(source), 3, 3))
    places[:, 1:] = [[3, 2, 0], [-3, 2, 0]]
    places[:, 1:, 1] += 0.5 * jaw[:, None]
    return Controls(
        shapes=("jawOpen", "eyeBlink", "smile"),
        weights=np.stack([jaw**0.7, blink, np.sqrt(smile) * (1 - 0.3 * jaw)], axis=1),
        joints=JOINTS,
        translations=places,
        rotations=Rotation.from_rotvec(turns.reshape(-1, 3))
        .as_quat(scalar_first=True)
        .reshape(-1, 3, 4),
        scales=np.ones((len(source), 3, 3)),
        attributes=ATTRIBUTES,
        values=np.stack([0.25 + 0.5 * jaw, smile - blink], axis=1),
    )


def human_moves(frames: int) -> np.ndarray:
    """Weights that rise and fall, each in its own time."""
    time = np.arange(frames)[:, None] / 24.0
    return 0.5 - 0.5 * np.cos(2 * np.pi * time * [0.7, 0.31, 0.53] + [0.0, 0.4, 0.9])


def write_human_performance(path: Path, rig: Rig, weights: np.ndarray, *, first: int = 101) -> None:
    with writing_performance(
        path,
        make_header(
            rig,
            shape_names=("jawOpen", "eyeBlink", "smile"),
            rate=RATE,
            first_frame=first,
            last_frame=first + len(weights) - 1,
            timecode_start="01:00:04:05",
        ),
        rig,
    ) as writer:
        writer.append(weights)


def write_creature_performance(path: Path, rig: Rig, controls: Controls, *, first: int = 1) -> None:
    with writing_control_performance(
        path,
        make_header(
            rig,
            shape_names=controls.shapes,
            rate=RATE,
            first_frame=first,
            last_frame=first + len(controls) - 1,
        ),
        rig,
        joints=controls.joints,
        attributes=controls.attributes,
    ) as writer:
        writer.append(controls)
