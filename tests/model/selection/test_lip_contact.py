"""Lips that touch on the performer touch on the character, and nothing else changes."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.model.selection.lip_contact import Lips, find_lips, keep_lip_contact, lip_gap_mm
from usdface.numerics.measure.face_regions import jaw_opener, shapes_by_region
from usdface.numerics.measure.performance_error import find_lip_pairs
from usdface.numerics.registration.virtual_markers import VirtualMarkers, marker_deltas
from usdface.numerics.solve.blendshape_equation import MarkerKeys


@dataclass(frozen=True)
class Mouth:
    """The demo's character as its own performer: markers sit on points of it."""

    rig: Rig
    deformer: Deformer
    equation: BlendshapeEquation
    lips: Lips

    def markers(self, weights: np.ndarray) -> np.ndarray:
        return self.equation.neutral + np.einsum("fs,smc->fmc", weights, self.equation.deltas)


@pytest.fixture(scope="module")
def mouth() -> Mouth:
    rig = demo_rig()
    deformer = Deformer(rig)
    offsets = deformer.shapes.target_offsets()
    jaw = jaw_opener(rig.shapes)
    assert jaw is not None
    region = shapes_by_region(rig.shapes)["mouth"]
    pairs = find_lip_pairs(deformer.neutral, offsets, jaw_open=jaw, mouth=region)
    assert pairs is not None
    rng = np.random.default_rng(0)
    others = rng.choice(len(deformer.neutral), 20, replace=False)
    points = np.concatenate([pairs.upper[::3], pairs.lower[::3], others])
    count = len(points)
    virtual = VirtualMarkers(
        points=np.repeat(points[:, None], 3, axis=1),
        weights=np.repeat([[1.0, 0.0, 0.0]], count, axis=0),
        motion_scale=1.0,
        rotation=np.eye(3),
    )
    keys = MarkerKeys(
        marker_deltas(virtual, deformer.shapes.key_offsets),
        deformer.shapes.key_channels,
        deformer.shapes.key_weights,
    )
    equation = BlendshapeEquation(
        virtual=virtual,
        deltas=marker_deltas(virtual, offsets),
        keys=keys,
        neutral=deformer.neutral[points],
        ranges=rig.ranges,
        trust=np.ones(count),
        gain=np.ones(count),
    )
    lips = find_lips(equation, deformer, rig.shapes)
    assert lips is not None
    return Mouth(rig, deformer, equation, lips)


def test_a_mouth_that_least_squares_left_open_is_closed(mouth: Mouth) -> None:
    jaw = jaw_opener(mouth.rig.shapes)
    truth = np.zeros((3, len(mouth.rig.shapes)))
    start = truth.copy()
    start[:, jaw] = (0.05, 0.1, 0.2)
    closed = keep_lip_contact(
        mouth.equation, mouth.deformer, mouth.lips, mouth.markers(truth), start
    )
    assert lip_gap_mm(mouth.deformer, mouth.lips, start).min() > 0.5
    assert lip_gap_mm(mouth.deformer, mouth.lips, closed).max() < 0.3
    changed = np.flatnonzero((closed != start).any(axis=0))
    assert set(changed) <= set(mouth.lips.columns)
    ranges = mouth.rig.ranges
    assert ((closed >= ranges[:, 0] - 1e-12) & (closed <= ranges[:, 1] + 1e-12)).all()


def test_an_open_mouth_stays_as_it_is(mouth: Mouth) -> None:
    jaw = jaw_opener(mouth.rig.shapes)
    truth = np.zeros((2, len(mouth.rig.shapes)))
    truth[:, jaw] = (0.3, 0.9)
    start = np.clip(truth + 0.05, 0, 1)
    same = keep_lip_contact(mouth.equation, mouth.deformer, mouth.lips, mouth.markers(truth), start)
    np.testing.assert_array_equal(same, start)


def test_lips_that_meet_already_are_left_alone(mouth: Mouth) -> None:
    neutral = np.zeros((1, len(mouth.rig.shapes)))
    same = keep_lip_contact(
        mouth.equation, mouth.deformer, mouth.lips, mouth.markers(neutral), neutral
    )
    np.testing.assert_array_equal(same, neutral)


def test_a_rig_whose_names_tell_nothing_has_no_lips(mouth: Mouth) -> None:
    names = tuple(f"shape_{i}" for i in range(len(mouth.rig.shapes)))
    assert find_lips(mouth.equation, mouth.deformer, names) is None


def test_lips_pressed_beyond_touching_are_closed_as_well(mouth: Mouth) -> None:
    jaw = jaw_opener(mouth.rig.shapes)
    pressed, start = np.zeros((2, 1, len(mouth.rig.shapes)))
    pressed[:, jaw], start[:, jaw] = -0.2, 0.2
    closed = keep_lip_contact(
        mouth.equation, mouth.deformer, mouth.lips, mouth.markers(pressed), start
    )
    assert lip_gap_mm(mouth.deformer, mouth.lips, closed).max() < 0.3


def test_shapes_that_hardly_move_the_lips_are_not_thrown_to_their_limits_in_vain(
    mouth: Mouth,
) -> None:
    ranges = mouth.rig.ranges.copy()
    able = mouth.lips.columns[np.abs(mouth.lips.opening) > 0.3]  # mm; of 28 that the jaw has
    ranges[able] = 0.5, 0.5 + 1e-12  # all that could close the mouth are held
    held = replace(mouth.equation, ranges=ranges)
    start = np.clip(np.zeros((1, len(ranges))), ranges[:, 0], ranges[:, 1])
    assert lip_gap_mm(mouth.deformer, mouth.lips, start) > 1
    shut = mouth.markers(np.zeros_like(start))
    left = keep_lip_contact(held, mouth.deformer, mouth.lips, shut, start)
    np.testing.assert_array_equal(left, start)
