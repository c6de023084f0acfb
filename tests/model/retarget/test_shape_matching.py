"""Shapes matched by what they do: on faces of other proportions, topology and names."""

from pathlib import Path

import numpy as np
import pytest

from usdface.demo.rig import demo_rig
from usdface.demo.sculpt import ACTOR
from usdface.model.retarget.shape_matching import correspond, match_deformations, match_positions
from usdface.usdio.rig.read import read_rig


@pytest.fixture(scope="module")
def faces():
    return demo_rig(), demo_rig(ACTOR)


def test_another_face_with_the_same_shapes_is_matched(faces) -> None:
    hero, actor = faces
    matches = match_deformations(actor, hero, source_shapes=actor.shapes, target_shapes=hero.shapes)
    right = [match for match in matches if match.source == match.target]
    assert len(matches) >= 45
    assert len(right) >= 0.9 * len(matches)
    assert all(0.5 <= match.similarity <= 1.0 + 1e-9 for match in matches)
    assert len({match.target for match in matches}) == len(matches)


def test_matching_positions_recovers_a_pose_of_the_same_face(faces) -> None:
    hero, _ = faces
    both = correspond(hero, hero)
    weights = np.zeros((2, len(hero.shapes)))
    weights[0, hero.shapes.index("jawOpen")] = 0.8
    weights[1, hero.shapes.index("mouthSmileLeft")] = 1.0
    found = match_positions(both, weights)
    assert (found >= 0).all()
    assert found[0].argmax() == hero.shapes.index("jawOpen")
    assert found[1].argmax() == hero.shapes.index("mouthSmileLeft")
    np.testing.assert_allclose(found[weights > 0], weights[weights > 0], atol=0.15)


def test_nothing_to_match_is_no_match(faces) -> None:
    assert match_deformations(*faces, source_shapes=(), target_shapes=("jawOpen",)) == ()


def test_heads_of_two_makers_are_matched(shared_data: Path) -> None:
    ict = read_rig(shared_data / "rigs" / "ict_face.usdc")
    cap = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    matches = match_deformations(ict, cap, source_shapes=ict.shapes, target_shapes=cap.shapes)
    right = [m for m in matches if m.target == m.source or m.source[:-2] == m.target]
    assert len(matches) >= 45
    assert len(right) >= 0.88 * len(matches)  # those that are not: two ways to say the same
    # The other way round it is the same two faces at the same places.
    again = match_deformations(cap, ict, source_shapes=cap.shapes, target_shapes=ict.shapes)
    right = [m for m in again if m.target == m.source or m.target[:-2] == m.source]
    assert len({m.source for m in right}) >= 42
