"""Left is left: a performer seen in a mirror moves the other half of the character's face."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.synthetic import sample_skin
from tests.steps.small_shot import Shot
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MotionSpace, References, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.numerics.measure.face_regions import mirrored_shapes
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

pytestmark = pytest.mark.usefixtures("without_comparison")

FLIP = np.array([-1.0, 1.0, 1.0])

ONE_SIDED = 0.05
"""Root mean square difference of a shape and its opposite over the shot."""


def opposite_markers(names: tuple[str, ...]) -> IntArray:
    """Left for right; the rigid markers are numbered through, 3 opposite to 4 and so on."""

    def other(name: str) -> str:
        if name in ("head_1", "head_2"):
            return name
        if name.startswith("head_"):
            number = int(name.removeprefix("head_"))
            return f"head_{number + 1 if number % 2 else number - 1}"
        return re.sub(r"_([LR])(\d*)$", lambda m: "_" + "RL"["LR".index(m[1])] + m[2], name)

    return np.array([names.index(other(name)) for name in names])


class Mirror:
    """The plane that halves a face, wherever its head stands."""

    def __init__(self, names: tuple[str, ...], neutral: FloatArray) -> None:
        self.opposite = opposite_markers(names)
        seen = neutral[self.opposite] * FLIP
        self._from, self._to = seen.mean(axis=0), neutral.mean(axis=0)
        turn, _ = Rotation.align_vectors(neutral - self._to, seen - self._from)
        self._turn = turn.as_matrix()

    def positions(self, markers: FloatArray) -> FloatArray:
        return (markers[..., self.opposite, :] * FLIP - self._from) @ self._turn.T + self._to

    def motion(self, motion: MotionSpace) -> MotionSpace:
        def mirrored(rows: FloatArray) -> FloatArray:
            markers = rows.reshape(-1, len(self.opposite), 3)
            return ((markers[:, self.opposite] * FLIP) @ self._turn.T).reshape(rows.shape)

        mean = self.positions(motion.mean.reshape(-1, 3)).ravel()
        return replace(motion, mean=mean, components=mirrored(motion.components))


def mirrored_references(references: References, mirror: Mirror, shapes: IntArray) -> References:
    assert references.motion is not None
    return replace(
        references,
        markers=mirror.positions(references.markers.astype(float)),
        weights=references.weights[:, shapes],
        neutral=mirror.positions(references.neutral),
        motion=mirror.motion(references.motion),
    )


def frames_of(shot: Shot, mapping: TrainedMapping) -> FloatArray:
    markers = read_take(shot / "shot.clean.take.usda").markers
    assert markers is not None
    assert markers.names == mapping.marker_names
    return markers.positions[::4].astype(float)


def test_the_mirrored_markers_of_a_performer_drive_the_other_side(finished_shot: Shot) -> None:
    mapping = read_mapping(finished_shot / "hero.mapping.usdc")
    mirror = Mirror(mapping.marker_names, mapping.neutral)
    positions = frames_of(finished_shot, mapping)
    shapes = mirrored_shapes(mapping.shape_names)
    plain = WeightPredictor(mapping).predict(positions).weights
    seen = WeightPredictor(mapping).predict(mirror.positions(positions)).weights
    told = np.array([not name.startswith("eyeLook") for name in mapping.shape_names])
    away = np.sqrt(((seen - plain[:, shapes])[:, told] ** 2).mean())
    assert away < 0.04  # what the actor's halves differ by; references showed one of them only
    one_sided = np.sqrt(((plain - plain[:, shapes]) ** 2).mean(axis=0)) > ONE_SIDED
    range_shown = np.ptp(plain, axis=0)  # the opposite of what no reference shows is not known
    both_shown = np.minimum(range_shown, range_shown[shapes]) > 0.2
    acted = np.flatnonzero(one_sided & told & both_shown)
    assert {"mouthSmileLeft", "browOuterUpLeft"} <= {mapping.shape_names[i] for i in acted}
    for shape in acted:
        opposite, same = (
            np.corrcoef(seen[:, shape], plain[:, other])[0, 1] for other in (shapes[shape], shape)
        )
        assert opposite > 0.9, mapping.shape_names[shape]
        assert opposite > same + 0.2, mapping.shape_names[shape]


@pytest.mark.parametrize(
    "method", ["ridge", "d06", "kernel_cca", pytest.param("face_map", marks=pytest.mark.slow)]
)
def test_training_on_the_mirror_image_gives_the_mirrored_mapping(
    finished_shot: Shot, method: str
) -> None:
    references = read_references(finished_shot / "hero.references.usda")
    rig = read_rig(finished_shot / "hero.usdc")
    columns = [rig.shapes.index(name) for name in references.shape_names]
    surface = Deformer(rig).shapes
    gram = surface.gram()[np.ix_(columns, columns)]
    skin = sample_skin(surface.target_offsets())[columns]
    mirror = Mirror(references.marker_names, references.neutral)
    shapes = mirrored_shapes(references.shape_names)
    given = {"ranges": rig.ranges[columns], "method": method}
    mapping = train_mapping(references, gram=gram, skin=skin, **given)
    other = train_mapping(
        mirrored_references(references, mirror, shapes),
        gram=gram[np.ix_(shapes, shapes)],
        skin=skin[shapes] * FLIP,
        **given,
    )
    positions = frames_of(finished_shot, mapping)
    plain = WeightPredictor(mapping).predict(positions).weights
    seen = WeightPredictor(other).predict(mirror.positions(positions)).weights
    np.testing.assert_allclose(seen, plain[:, shapes], atol=5e-6)  # single precision
    assert np.abs(seen - plain).max() > 0.3
