"""A dog-like character, derived from the built-in head: 28 shapes, 8 joints, 36 float controls.

It stands in for the characters of Song et al. (2011): other proportions, ears with joints, and
attributes of a lattice deformer. Its controls for a source's weights are a nonlinear formula, the
truth against which retargeting is measured.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.core.controls import Controls
from usdface.demo.head import DemoHead, HeadPart
from usdface.demo.rig import make_head, mesh_points, rig_from_head
from usdface.demo.sculpt import CHARACTER
from usdface.model.retarget.shape_names import motion_and_side
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import RigControls, from_parents, write_rig

DOG_SHAPES = {
    "jawDrop": "jawOpen",
    "jawThrust": "jawForward",
    "jawSideL": "jawLeft",
    "jawSideR": "jawRight",
    "lipCornerPuller_L": "mouthSmileLeft",
    "lipCornerPuller_R": "mouthSmileRight",
    "lipCornerDepressor_L": "mouthFrownLeft",
    "lipCornerDepressor_R": "mouthFrownRight",
    "upperLipRaiser_L": "mouthUpperUpLeft",
    "upperLipRaiser_R": "mouthUpperUpRight",
    "lowerLipDepressor_L": "mouthLowerDownLeft",
    "lowerLipDepressor_R": "mouthLowerDownRight",
    "lipPucker": "mouthPucker",
    "lipFunneler": "mouthFunnel",
    "noseWrinkler_L": "noseSneerLeft",
    "noseWrinkler_R": "noseSneerRight",
    "cheekPuff": "cheekPuff",
    "blink_L": "eyeBlinkLeft",
    "blink_R": "eyeBlinkRight",
    "upperLidRaiser_L": "eyeWideLeft",
    "upperLidRaiser_R": "eyeWideRight",
    "lidTightener_L": "eyeSquintLeft",
    "lidTightener_R": "eyeSquintRight",
    "browLowerer_L": "browDownLeft",
    "browLowerer_R": "browDownRight",
    "innerBrowRaiser": "browInnerUp",
    "outerBrowRaiser_L": "browOuterUpLeft",
    "outerBrowRaiser_R": "browOuterUpRight",
}
"""The dog's shapes with FACS names, and the human shapes they are made of."""

JOINTS = (
    "head",
    "head/ear_L",
    "head/ear_L/tip",
    "head/ear_R",
    "head/ear_R/tip",
    "head/muzzle",
    "head/muzzle/nose",
    "head/crown",
)

PLACES_MM = np.array(
    [
        [0.0, 0.0, 0.0],
        [62.0, 62.0, -16.0],
        [80.0, 118.0, -18.0],
        [-62.0, 62.0, -16.0],
        [-80.0, 118.0, -18.0],
        [0.0, -45.0, 85.0],
        [0.0, -30.0, 165.0],
        [0.0, 95.0, -10.0],
    ]
)
"""Positions of the joints [mm]."""

LATTICE = tuple(
    f"dfm:point{row}{column}:{axis}" for row in range(3) for column in range(4) for axis in "xyz"
)
DOG_ATTRIBUTES = tuple(f"rig/lattice.{name}" for name in LATTICE)


def warp_to_dog(points: FloatArray) -> FloatArray:
    """Deform points of a human face so that they form a muzzle."""
    x, y, z = points.T
    lies = np.exp(-((x / 36.0) ** 4)) * np.exp(-(((y + 58.0) / 46.0) ** 4))
    ahead = np.clip((z - 45.0) / 55.0, 0.0, 1.0)
    pull = lies * ahead**2 * (3 - 2 * ahead)
    wide = 1.0 + 0.15 * np.exp(-(((y + 10) / 80.0) ** 2))
    return np.stack([x * wide * (1 - 0.12 * pull), y + 14.0 * pull, z + 72.0 * pull], axis=1)


@cache
def _human() -> DemoHead:
    return make_head(CHARACTER)


def dog_rig() -> Rig:
    """Return the dog's meshes and shapes, without joints and controls."""
    head = _human()
    human = rig_from_head(head)
    parts = {name: head.parts[points] for name, points in mesh_points(head).items()}
    kept = ("skin", "eyes", "teeth", "tongue", "brows")
    meshes = tuple(
        _dog_mesh(mesh, parts[mesh.path.rpartition("/")[2]])
        for mesh in human.meshes
        if mesh.path.rpartition("/")[2] in kept
    )
    return Rig(
        file=Path(),
        prim="/dog",
        shapes=tuple(DOG_SHAPES),
        meshes=meshes,
        ranges=np.tile([0.0, 1.0], (len(DOG_SHAPES), 1)),
    )


def write_dog(path: Path) -> Rig:
    """Write the dog with its joints and controls, and read it back."""
    rig = dog_rig()
    head = _human()
    ears = head.parts[mesh_points(head)["skin"]] == int(HeadPart.EARS)
    influences = {
        mesh.path: _influences(mesh.points, ears)
        for mesh in rig.meshes
        if mesh.path.endswith("/skin")
    }
    write_rig(path, rig, controls=RigControls(JOINTS, PLACES_MM, influences, DOG_ATTRIBUTES))
    return read_rig(path)


def expressions(names: tuple[str, ...]) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and weights of 34 source expressions: rest, single shapes, and five moods."""
    moods = {
        "joy": {"mouthsmile": 0.9, "cheeksquint": 0.7, "eyesquint": 0.4, "jawopen": 0.3},
        "anger": {"browdown": 1.0, "nosesneer": 0.7, "mouthupperup": 0.6, "eyesquint": 0.5},
        "surprise": {"browinnerup": 1.0, "browouterup": 0.9, "eyewide": 0.9, "jawopen": 0.7},
        "sadness": {"browinnerup": 0.8, "mouthfrown": 0.9, "eyelookdown": 0.4, "eyeblink": 0.2},
        "snarl": {"nosesneer": 1.0, "mouthupperup": 1.0, "jawopen": 0.25},
    }
    rows = [np.zeros(len(names))]
    for human in DOG_SHAPES.values():
        rows.append(np.isin(names, _like(names, human)).astype(float))
    for mood in moods.values():
        row = np.zeros(len(names))
        for motion, weight in mood.items():
            row[np.isin(names, _like(names, motion))] = weight
        rows.append(row)
    return ("rest", *DOG_SHAPES, *moods), np.array(rows)


def act(names: tuple[str, ...], weights: FloatArray) -> Controls:
    """Return the dog's controls for source weights: the truth, from which pairs are keyed."""
    shapes = np.stack(
        [
            weights[:, np.isin(names, _like(names, human))].sum(axis=1)
            for human in DOG_SHAPES.values()
        ],
        axis=1,
    )
    shapes /= np.maximum([len(_like(names, human)) for human in DOG_SHAPES.values()], 1)
    bent = 1.1 * np.tanh(1.6 * shapes) / np.tanh(1.6)  # a steep onset, as in cartoons

    def level(*motions: str) -> FloatArray:
        found = [weights[:, np.isin(names, _like(names, motion))] for motion in motions]
        return np.asarray(np.concatenate(found, axis=1).mean(axis=1))

    anger, up, joy = (
        level("browdown", "nosesneer"),
        level("browinnerup", "browouterup"),
        level("mouthsmile"),
    )
    turns = np.zeros((len(weights), len(JOINTS), 3))
    for side, joint in ((1, 1), (-1, 3)):
        turns[:, joint] = np.stack(
            [-0.9 * anger + 0.5 * up, 0 * up, -side * (0.9 * anger - 0.4 * joy)], 1
        )
        turns[:, joint + 1] = np.stack([-0.5 * anger + 0.7 * up, 0 * up, -side * 0.6 * anger], 1)
    turns[:, 5, 0] = 0.12 * anger - 0.1 * level("jawopen")
    turns[:, 6, 0] = 0.2 * level("nosesneer")
    lengths = np.zeros((len(weights), len(JOINTS), 3))
    lengths[:, 7, 1] = 0.8 * up
    rest = 0.1 * from_parents(JOINTS, PLACES_MM)  # in the rig's unit
    rng = np.random.default_rng(7)
    mix = rng.normal(0, 0.5, (shapes.shape[1], len(DOG_ATTRIBUTES)))
    return Controls(
        shapes=tuple(DOG_SHAPES),
        weights=np.clip(bent, 0.0, 1.0),
        joints=JOINTS,
        translations=rest + lengths,
        rotations=Rotation.from_rotvec(turns.reshape(-1, 3))
        .as_quat(scalar_first=True)
        .reshape(*turns.shape[:2], 4),
        scales=1.0 + 0.15 * np.repeat(up[:, None, None], len(JOINTS), axis=1) * [0, 1, 0],
        attributes=DOG_ATTRIBUTES,
        values=np.tanh(shapes @ mix) + 0.2 * shapes**2 @ mix,
    )


def _like(names: tuple[str, ...], human: str) -> list[str]:
    motion, side = motion_and_side(human)
    every = {name: motion_and_side(name) for name in names}
    return [n for n, own in every.items() if own[0] == motion and side in ("", own[1])]


def _dog_mesh(mesh: RigMesh, parts: IntArray) -> RigMesh:
    name = mesh.path.rpartition("/")[2]
    ears = parts == int(HeadPart.EARS)

    def place(points: FloatArray, chosen: IntArray) -> FloatArray:
        moved = warp_to_dog(points)
        return np.where(ears[chosen][:, None], _ear(points), moved)

    every = np.arange(len(mesh.points), dtype=np.int64)
    human = {human: dog for dog, human in DOG_SHAPES.items()}
    shapes = []
    for shape in mesh.shapes:
        if shape.name not in human:
            continue
        keys = tuple(
            ShapeKey(
                key.weight,
                key.points,
                place(mesh.points[key.points] + key.offsets, key.points)
                - place(mesh.points[key.points], key.points),
            )
            for key in shape.keys
        )
        shapes.append(MeshShape(human[shape.name], keys))
    colors = mesh.colors
    if colors is not None and name == "skin":
        colors = _coat(place(mesh.points, every), colors, ears)
    return replace(
        mesh,
        path=f"/dog/geometry/{name}",
        points=place(mesh.points, every),
        shapes=tuple(shapes),
        colors=colors,
    )


def _ear(points: FloatArray) -> FloatArray:
    """Deform a human ear to a larger, erect one."""
    side = np.sign(points[:, :1])
    middle = np.array([74.0, -8.0, -14.0])
    own = (points - side * middle * [1, 0, 0]) - middle * [0, 1, 1]
    grown = own * [1.3, 2.2, 1.6]
    place = [side * 66.0, np.full_like(side, 88.0), np.full_like(side, -14.0)]
    return np.asarray(grown + np.concatenate(place, 1))


def _coat(points: FloatArray, colors: FloatArray, ears: BoolArray) -> FloatArray:
    """Return colours of brown fur, a pale muzzle and a black nose."""
    brown, pale = np.array([0.30, 0.17, 0.08]), np.array([0.62, 0.47, 0.32])
    muzzle = np.clip((points[:, 2] - 75.0) / 45.0, 0, 1)[:, None]
    coat = brown * (1 - muzzle) + pale * muzzle
    coat = coat * (0.6 + 0.4 * colors.mean(axis=1, keepdims=True) / colors.mean())
    nose = np.linalg.norm(points - np.array([0.0, -26.0, 172.0]), axis=1) < 17.0
    coat[nose] = 0.03
    coat[ears] *= 0.6
    return np.asarray(np.clip(coat, 0, 1))


def _influences(points: FloatArray, of_ear: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return three joints per point and their weights: ears bend, the rest follows the head."""
    owner = np.zeros((len(points), 3), np.int64)
    share = np.zeros((len(points), 3))
    share[:, 0] = 1.0
    for side, joint in ((1, 1), (-1, 3)):
        up = (side * points[:, 0] > 0) & of_ear
        height = np.clip((points[up, 1] - 52.0) / 25.0, 0, 1)
        tip = np.clip((points[up, 1] - 100.0) / 30.0, 0, 1)
        owner[up] = [0, joint, joint + 1]
        share[up] = np.stack([1 - height, height * (1 - tip), height * tip], axis=1)
    return owner, share
