"""The small rig with logic: a combination, one of a combination and an in-between of its own."""

from dataclasses import replace

import numpy as np

from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, Rig, ShapeKey
from usdface.core.rig_logic import Combination

COMBINATIONS = (
    Combination("jaw_smile", ("jawOpen", "smile")),
    Combination("smile50", ("smile",), weights=(0.5,)),
    Combination("all", ("jaw_smile", "eyeBlink"), "minimum"),
)


def driven_rig(prim: str = "/Hero") -> Rig:
    rig = small_rig(prim)
    rng = np.random.default_rng(1)
    skin = rig.meshes[0]
    more = [
        MeshShape(each.shape, (ShapeKey(1.0, np.arange(5), rng.normal(0, 4, (5, 3))),))
        for each in COMBINATIONS
    ]
    meshes = (replace(skin, shapes=(*skin.shapes, *more)), *rig.meshes[1:])
    return replace(rig, meshes=meshes, combinations=COMBINATIONS)
