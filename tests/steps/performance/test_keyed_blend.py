"""A hybrid of markers whose blend is keyed: its ends are the parts, between them it is straight."""

from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from tests.model.synthetic import SyntheticFace, references_of, synthetic_face
from tests.steps.small_shot import Shot
from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import MappedMarkers
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.base import Choices
from usdface.runner.execute import execute
from usdface.specs.performance import MapSpec
from usdface.steps.inputs.alpha_keys import read_alpha
from usdface.steps.performance.map import predict_with_keyed_blend

RATE = Fraction(60)

pytestmark = pytest.mark.usefixtures("without_comparison")


@pytest.fixture(scope="module")
def hybrid() -> tuple[SyntheticFace, TrainedMapping]:
    face = synthetic_face(frames=300, bend=0.2)
    references = references_of(face, np.arange(0, 300, 12))
    trained = train_mapping(
        references, ranges=face.ranges, gram=face.gram, method="hybrid", choices=Choices((6,))
    )
    return face, trained


def test_alpha_runs_from_one_part_to_the_other(
    hybrid: tuple[SyntheticFace, TrainedMapping], tmp_path: Path
) -> None:
    face, mapping = hybrid
    (tmp_path / "alpha.csv").write_text("frame,alpha\n1,0\n100,1\n")
    positions = face.positions[:100].astype(np.float32)
    visible = np.ones(positions.shape[:2], bool)
    blocks = [range(1, 61), range(61, 101)]
    placed = (
        partial(
            MappedMarkers,
            positions[b.start - 1 : b.stop - 1],
            visible[b.start - 1 : b.stop - 1],
            np.ones((len(b), positions.shape[1]), np.float32),
        )
        for b in blocks
    )
    shares = [
        read_alpha(tmp_path / "alpha.csv", np.arange(b.start, b.stop), rate=RATE, whole=False)
        for b in blocks
    ]
    answers = list(predict_with_keyed_blend(mapping, placed, shares))
    blended = np.concatenate([each.weights for each in answers])
    ends = [
        WeightPredictor(replace(mapping, settings=mapping.settings | {"alpha": share}))
        .predict(positions, visible=visible)
        .weights
        for share in (0.0, 1.0)
    ]
    share = np.linspace(0, 1, 100)[:, None]
    # Prediction projects in single precision.
    straight = (1 - share) * ends[0] + share * ends[1]
    np.testing.assert_allclose(blended, straight, rtol=0, atol=1e-6)
    assert np.abs(ends[1] - ends[0]).max() > 1e-3
    assert len(answers[0].uncertainty) == 60


def test_keys_at_other_times_than_the_motion_are_refused(tmp_path: Path) -> None:
    """Such as keys counted from 1, for a take that starts at 1001."""
    (tmp_path / "alpha.csv").write_text("frame,alpha\n1,0\n100,1\n")
    frames = np.arange(1001, 1101)
    with pytest.raises(InputError, match=r"keys frames 1 to 100, all outside .* 1001 to 1100"):
        read_alpha(tmp_path / "alpha.csv", frames, rate=RATE, whole=True)
    np.testing.assert_array_equal(
        read_alpha(tmp_path / "alpha.csv", frames, rate=RATE, whole=False), 1
    )
    layer = tmp_path / "alpha.usda"
    stage = Usd.Stage.CreateNew(str(layer))
    keys = stage.DefinePrim("/Alpha").CreateAttribute(
        "face:mapping:alpha", Sdf.ValueTypeNames.Float
    )
    for frame in (1001, 1100):
        keys.Set(frame / 1100, frame)
    stage.Save()
    assert read_alpha(layer, frames, rate=RATE, whole=True)[-1] == 1
    stage.SetTimeCodesPerSecond(24)
    stage.Save()
    with pytest.raises(InputError, match=r"at 24 time codes per second, and the motion has 60"):
        read_alpha(layer, frames, rate=RATE, whole=True)
    (tmp_path / "constant.csv").write_text("frame,alpha\n1,0.3\n")
    np.testing.assert_array_equal(
        read_alpha(tmp_path / "constant.csv", frames, rate=RATE, whole=True), 0.3
    )


def test_what_is_no_hybrid_has_nothing_to_blend(shot: Shot) -> None:
    (shot / "alpha.csv").write_text("frame,alpha\n1,0.5\n")
    spec = MapSpec(
        take=shot / "shot.clean.take.usda",
        mapping=shot / "hero.mapping.usdc",
        rig=shot / "hero.usdc",
        out=shot / "keyed.usda",
        alpha=shot / "alpha.csv",
    )
    with pytest.raises(InputError, match="train with --method hybrid"):
        execute(spec)
