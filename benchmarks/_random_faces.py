"""Set-ups of retargeting drawn at random, and the faces that are retargeted to."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks._takes import channel_of
from benchmarks.retarget import strongest
from tests.conftest import SHARED_DATA
from usdface.core.assets import MeshShape, Rig, ShapeKey
from usdface.core.deformer import Deformer
from usdface.demo.dog import act, dog_rig
from usdface.usdio.rig.read import read_rig

MATES = {"merged": [("left", "right")], "opposite": [("smile", "frown"), ("outerup", "down")]}
"""Parts of names of shapes that are one shape of the target."""
CROSSTALK = 0.2
"""Share of a shape's weight that moves another as well, in asymmetric faces."""


@dataclass(frozen=True)
class Setup:
    """What is drawn for a set-up."""

    source: str
    target: str
    shapes: str
    """How the target's shapes decompose its face."""
    full: float
    """Weight at which a shape of the target is full."""
    relation: str
    pairs: int
    chosen: str
    keys: str
    rest: bool
    """Whether a pair is at rest."""
    hidden: str
    """Beginning of the names of shapes at rest in all pairs, or an empty string."""
    tested: str
    strength: float
    """Factor of the tested weights."""
    noise: float
    """Standard deviation of the tested weights' noise."""

    def __str__(self) -> str:
        rest = "" if self.rest else " without rest"
        return (
            f"{self.pairs} pairs, {self.chosen}{rest}, {self.keys} keys; {self.shapes} shapes of "
            f"{self.target}, {self.relation}"
        )


def draw_setup(rng: np.random.Generator) -> Setup:
    """Draw a set-up."""
    choice = rng.choice
    shapes = ["named", "merged", "fewer", "split", "opposite", "mixed", "products"]
    dog = rng.random() < 0.15
    return Setup(
        source=str(choice(["ict_face", "facecap_head"])),
        target="dog" if dog else str(choice(["ict_face", "facecap_head"])),
        shapes="its" if dog else str(choice(shapes)),
        full=float(choice([1, 1, 10])),
        relation=str(choice(["linear", "saturating", "late", "asymmetric", "exclusive"])),
        pairs=int(choice([6, 12, 25, 50, 80])),
        chosen=str(choice(["single", "symmetric", "moods", "random", "large"])),
        keys=str(
            choice(
                ["exact", "exact", "rounded", "inexact", "unequal", "one wrong", "contradictory"]
            )
        ),
        rest=bool(rng.random() < 0.8),
        hidden=str(choice(["", "", "brow", "jaw"])),
        tested=str(choice(["second half", "another", "bursts", "one side late"])),
        strength=float(choice([1, 1, 1, 2])),
        noise=float(choice([0, 0, 0.02])),
    )


def make_target(
    setup: Setup, names: tuple[str, ...], rng: np.random.Generator
) -> tuple[Callable[[np.ndarray], np.ndarray], Rig, np.ndarray]:
    """Return the function from source weights to the target's, its rig, and its offsets [mm]."""
    if setup.target == "dog":
        rig = dog_rig()
        return (lambda weights: act(names, weights).weights), rig, _offsets(rig)
    base = read_rig(SHARED_DATA / "rigs" / f"{setup.target}.usdc")
    dense, own = _offsets(base), [channel_of(name) for name in base.shapes]
    channels = np.zeros((len(names), *dense.shape[1:]))
    for row, name in enumerate(names):
        sides = [own.index(s) for s in (name, name + "left", name + "right") if s in own]
        channels[row] = dense[sides].sum(axis=0)
    (mesh,) = base.meshes
    control, offsets = _decompose(setup.shapes, channels, mesh.points, names, rng)
    low = -1.0 if setup.shapes in ("opposite", "mixed") else 0.0
    gains = rng.uniform(0.6, 1.2, len(names))
    crosstalk = np.eye(len(names))
    if setup.relation == "asymmetric":
        crosstalk[np.arange(len(names)), rng.permutation(len(names))] += CROSSTALK
        gains *= np.where([name.endswith("right") for name in names], 0.7, 1.0)
    products = rng.permutation(len(names))[:12].reshape(2, 6)
    if setup.shapes == "products":
        offsets = np.vstack([offsets, 0.5 * (channels[products[0]] - channels[products[1]])])

    def act_target(weights: np.ndarray) -> np.ndarray:
        related = _relate(setup.relation, weights) @ crosstalk * gains
        controls = related @ control
        if setup.shapes == "products":
            controls = np.hstack([controls, related[:, products[0]] * related[:, products[1]]])
        return np.asarray(setup.full * np.clip(controls, low, 1))

    offsets = offsets / setup.full
    labels = names if setup.shapes == "named" else [f"ctl_{i:02d}" for i in range(len(offsets))]
    every = np.arange(len(mesh.points))
    shapes = [
        MeshShape(name, (ShapeKey(1.0, every, moved),))
        for name, moved in zip(labels, offsets, strict=True)
    ]
    ranges = np.tile([low * setup.full, setup.full], (len(labels), 1))
    meshes = (replace(mesh, shapes=tuple(shapes)),)
    return act_target, Rig(Path(), base.prim, tuple(labels), meshes, ranges), offsets


def _relate(name: str, weights: np.ndarray) -> np.ndarray:
    """Return the weights of the target's face, before gains, in the source's shapes."""
    if name == "saturating":
        return 1.1 * np.tanh(1.6 * weights) / np.tanh(1.6)
    if name == "late":
        return weights**2
    return strongest(weights) if name == "exclusive" else weights


def _decompose(
    name: str,
    channels: np.ndarray,
    places: np.ndarray,
    names: tuple[str, ...],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return weights of the target's shapes by those of channels, and the shapes' offsets."""
    count = len(names)
    if name == "split":
        upper = 1 / (1 + np.exp(-(places[:, 1] - np.median(places[:, 1])) / 15))[:, None]
        return np.hstack([np.eye(count)] * 2), np.vstack([channels * upper, channels * (1 - upper)])
    control, gone = np.eye(count), np.zeros(count, bool)
    if name == "fewer":
        gone[rng.permutation(count)[2 * count // 3 :]] = True
    if name == "mixed":
        for row in control:
            row[rng.permutation(count)[:3]] += rng.uniform(-0.3, 0.3, 3)
    for one, other in MATES.get(name, ()):
        for index in [i for i, each in enumerate(names) if one in each]:
            mate = names.index(names[index].replace(one, other))
            control[[index, mate], index] = (0.5, 0.5) if name == "merged" else (1, -1)
            gone[mate] = True
    control = control[:, ~gone]
    return control, np.einsum("cs,spd->cpd", np.linalg.pinv(control), channels)


def _offsets(rig: Rig) -> np.ndarray:
    return Deformer(rig).shapes.target_offsets().toarray().reshape(len(rig.shapes), -1, 3)
