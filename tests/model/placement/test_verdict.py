"""A verdict is green where markers are right, and names what is wrong where they are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.model.placement.marker_cloud import MarkerCloud
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.placement.verdict import PlacementVerdict, judge_placement, warn_upside_down
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin, sample_face_skin
from usdface.numerics.registration.virtual_markers import VirtualMarkers

LABELS = {
    "NoseTip": "nose_tip",
    "Chin": "chin",
    "Mouth_Lend": "mouth_L",
    "Mouth_Rend": "mouth_R",
    "Leye_Up": "lid_crease_L",
    "Reye_Up": "lid_crease_R",
    "Leye_Outer": "eye_outer_L",
    "Reye_Outer": "eye_outer_R",
    "Lbrow_Outer": "brow_outer_L",
    "Rbrow_Outer": "brow_outer_R",
    "Lbrow_Inner": "brow_inner_L",
    "Rbrow_Inner": "brow_inner_R",
    "Lip_Upper": "lip_upper",
    "Lip_Lower": "lip_lower",
}


class Bench:
    """Markers at a rig's own landmarks that move as the rig's shapes move them."""

    def __init__(self) -> None:
        rig = demo_rig()
        deformer = Deformer(rig)
        self.shapes, self.ranges = rig.shapes, rig.ranges
        self.skin: FaceSkin = sample_face_skin(
            deformer.neutral, deformer.triangles, deformer.shapes.target_offsets()
        )
        found = find_landmarks(self.skin, rig.shapes)
        self.local = np.array([found[name] for name in LABELS.values()])
        near = ((self.local[:, None] - self.skin.positions) ** 2).sum(axis=2).argmin(axis=1)
        weights = np.random.default_rng(0).random((60, len(rig.shapes))) ** 4
        motion = np.einsum("fs,smc->fmc", weights, self.skin.deltas[:, near])
        still = np.zeros(len(LABELS), np.bool_)
        self.cloud = MarkerCloud(tuple(LABELS), self.local, motion, still)

    def judge(self, local: np.ndarray, **changed: object) -> PlacementVerdict:
        count = len(local)
        skin: FaceSkin = changed.pop("skin", self.skin)  # type: ignore[assignment]
        shapes: tuple[str, ...] = changed.pop("shapes", self.shapes)  # type: ignore[assignment]
        virtual = VirtualMarkers(
            np.zeros((count, 3), np.int64),
            np.zeros((count, 3)),
            skin.unit,
            skin.frame.T,
        )
        given = {"at": skin.from_frame(local), "ranges": self.ranges, "by_labels": True} | changed
        cloud = given.pop("cloud", self.cloud)
        return judge_placement(cloud, skin, shapes, virtual, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def test_markers_at_their_landmarks_look_right(bench: Bench) -> None:
    verdict = bench.judge(bench.local)
    assert verdict.level == "good"
    assert verdict.explained > 0.8
    assert abs(verdict.roll_degrees) < 0.5
    assert not verdict.warnings


def test_one_marker_far_from_its_landmark_is_named_and_no_other(bench: Bench) -> None:
    moved = bench.local.copy()
    chin = list(LABELS).index("Chin")
    moved[chin] += [35.0, 0.0, 0.0]
    verdict = bench.judge(moved)
    assert verdict.level == "check"
    assert list(verdict.warnings) == ["Chin"]
    assert "Chin lies" in verdict.sentence
    np.testing.assert_allclose(verdict.wanted["Chin"], bench.skin.from_frame(bench.local[chin]))
    # Where a person put it, it may lie twice as far.
    assert not bench.judge(moved, placed=[chin]).warnings


@pytest.mark.parametrize("degrees", [-8.0, 8.0])
def test_a_tilted_cloud_looks_wrong(bench: Bench, degrees: float) -> None:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    middle = bench.local.mean(axis=0)
    turned = (bench.local - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + middle
    verdict = bench.judge(turned)
    assert verdict.level == "bad"
    assert "tilted by 8 degrees" in verdict.sentence
    assert abs(verdict.roll_degrees) == pytest.approx(8, abs=0.5)


def test_a_face_too_low_looks_wrong_and_the_motion_says_where_it_belongs(bench: Bench) -> None:
    low = bench.local - [0.0, 0.25 * TYPICAL_SIZE_MM, 0.0]
    verdict = bench.judge(low)
    assert verdict.level == "bad"
    assert "better" in verdict.sentence
    assert "higher" in verdict.sentence


@pytest.mark.parametrize(
    ("lacking", "words", "foreign"),
    [
        ("brow", "no shapes for the brows (4 markers; other shapes follow ", False),
        ("brow", "no shapes for the brows (4 markers; other shapes follow ", True),
        ("mouth", "no shapes for the mouth (4 markers; other shapes follow ", False),
        ("mouth", "no shapes for the mouth (4 markers; other shapes follow ", True),
        ("eyeBlink|eyeSquint|eyeWide|eyeLook", "no shapes for the lids (", False),
        ("tongue|eyeLook", "", False),
        ("tongue|eyeLook", "", True),
    ],
)
def test_a_region_without_shapes_is_named_although_others_carry_it(
    bench: Bench, lacking: str, words: str, foreign: bool
) -> None:
    verdict = judge_without(bench, lacking, foreign=foreign)
    assert verdict.level == ("check" if words else "good")
    assert words in verdict.sentence
    assert ("no shape" in verdict.sentence) == bool(words)


def test_a_rig_whose_eyes_do_not_close_is_named(bench: Bench) -> None:
    assert "no shape that closes the eyes" in judge_without(bench, "eyeBlink").sentence
    # A squint by another name is none either; what moves a lid as far as a blink is one.
    renamed = judge_without(bench, "eyeBlink|eyeLook", foreign=True)
    assert "no shape that closes the eyes" in renamed.sentence


def test_markers_that_no_shape_moves_are_named(bench: Bench) -> None:
    row = list(LABELS).index("Mouth_Lend")
    near = ((bench.local[row] - bench.skin.positions) ** 2).sum(axis=1) < 10.0**2
    bare = replace(bench.skin, deltas=np.where(near[:, None], 0.0, bench.skin.deltas))
    labels = list(LABELS)
    labels[row] = "m8"
    verdict = bench.judge(bench.local, cloud=replace(bench.cloud, labels=tuple(labels)), skin=bare)
    assert "no shape of the rig moves the skin at m8" in verdict.sentence


def test_markers_that_a_joint_would_move_are_named(bench: Bench) -> None:
    """The jaw opens by a joint, and has a shape for other motion."""
    opening = list(bench.shapes).index("jawOpen")
    near = ((bench.local[:, None] - bench.skin.positions) ** 2).sum(axis=2).argmin(axis=1)
    opened = 1.5 * np.sin(np.arange(60) / 4.0)[:, None, None] ** 2
    jaw = opened * bench.skin.deltas[opening, near]
    cloud = replace(bench.cloud, motion=bench.cloud.motion + jaw)
    assert "do not follow" not in bench.judge(bench.local, cloud=cloud).sentence
    upwards = bench.skin.deltas.copy()
    upwards[opening] *= [1.0, -1.0, 1.0]
    skin = replace(bench.skin, deltas=upwards)
    verdict = bench.judge(bench.local, cloud=cloud, skin=skin)
    assert re.search(r"shapes of the rig do not follow Chin \d+ mm", verdict.sentence)
    assert "no reference or tuning helps" in verdict.sentence
    # Placed by motion, the markers may as well be at wrong places.
    by_motion = bench.judge(bench.local, cloud=cloud, skin=skin, by_labels=False)
    assert "do not follow" not in by_motion.sentence


def judge_without(bench: Bench, lacking: str, *, foreign: bool = False) -> PlacementVerdict:
    """Judge right places on a rig without some shapes, named or numbered."""
    keep = [i for i, name in enumerate(bench.shapes) if not re.search(lacking, name)]
    return bench.judge(
        bench.local,
        skin=replace(bench.skin, deltas=bench.skin.deltas[keep]),
        ranges=bench.ranges[keep],
        shapes=tuple(f"s{i}" if foreign else bench.shapes[i] for i in keep),
    )


def test_markers_of_one_side_are_told(bench: Bench) -> None:
    rows = [row for row in range(len(LABELS)) if bench.local[row, 0] > bench.skin.sagittal_x + 5]
    cloud = bench.cloud
    half = MarkerCloud(
        tuple(cloud.labels[row] for row in rows),
        cloud.neutral[rows],
        cloud.motion[:, rows],
        cloud.still[rows],
    )
    verdict = bench.judge(bench.local[rows], cloud=half)
    assert verdict.level == "check"
    assert "on its left side only" in verdict.sentence


def test_markers_of_the_midline_are_on_no_side(bench: Bench) -> None:
    rows = [row for row in range(len(LABELS)) if bench.local[row, 0] > bench.skin.sagittal_x - 5]
    local = bench.local[rows].copy()
    middle = np.abs(local[:, 0] - bench.skin.sagittal_x) < 5
    assert middle.sum() >= 3
    local[middle, 0] = bench.skin.sagittal_x - 4
    labels = tuple(bench.cloud.labels[row] for row in rows)
    half = MarkerCloud(labels, local, bench.cloud.motion[:0, rows], bench.cloud.still[rows])
    assert "on its left side only" in bench.judge(local, cloud=half).sentence


@pytest.mark.parametrize(("count", "level"), [(0, "good"), (3, "bad")])
def test_markers_on_the_neck_look_wrong(bench: Bench, count: int, level: str) -> None:
    moved = bench.local.copy()
    moved[:count, 1] = bench.local[:, 1].min() - 60
    cloud = replace(
        bench.cloud,
        labels=tuple(f"m{i}" for i in range(len(moved))),
        motion=bench.cloud.motion[:0],
    )
    verdict = bench.judge(moved, cloud=cloud)
    assert ("far below the chin (m0, m1, m2)" in verdict.sentence) == (count > 0)
    assert verdict.level == level


def test_motion_alone_asks_for_a_look(bench: Bench) -> None:
    silent = replace(bench.cloud, labels=tuple(f"m{i}" for i in range(len(LABELS))))
    verdict = bench.judge(bench.local, cloud=silent, by_labels=False)
    assert verdict.level == "check"
    assert "motion alone" in verdict.sentence


def test_markers_that_fit_better_upside_down_look_wrong(bench: Bench) -> None:
    silent = replace(bench.cloud, labels=tuple(f"m{i}" for i in range(len(LABELS))))
    doubted = bench.judge(bench.local, cloud=silent, by_labels=False)
    assert warn_upside_down(doubted, 0.02) is doubted
    slightly = warn_upside_down(doubted, 0.06)
    assert slightly.sentence.startswith(
        "Look at it: the markers fit better upside down; if they lie so, ingest the takes again"
    )
    assert warn_upside_down(replace(doubted, level="bad"), 0.06).level == "bad"
    verdict = warn_upside_down(doubted, 0.2)
    assert verdict.level == "bad"
    assert verdict.sentence.startswith("Looks wrong: the markers fit far better upside down; ")
    assert verdict.sentence.endswith(doubted.sentence.removeprefix("Look at it: "))
    fine = warn_upside_down(bench.judge(bench.local), 0.2)
    assert fine.sentence.endswith("state --up")


def test_motion_and_labels_that_agree_look_right_unless_little_is_explained(bench: Bench) -> None:
    assert bench.judge(bench.local, by_labels=False).level == "good"
    noise = np.random.default_rng(0).normal(0, 7.0, bench.cloud.motion.shape)
    noisy = replace(bench.cloud, motion=bench.cloud.motion + noise)
    verdict = bench.judge(bench.local, cloud=noisy, by_labels=False)
    assert verdict.level != "good"
    assert "placed by motion, of which shapes explain" in verdict.sentence


def test_motion_that_shapes_explain_poorly_is_no_evidence_of_a_placement(bench: Bench) -> None:
    labels = tuple(f"m{n}" for n in range(len(LABELS)))
    cloud = replace(bench.cloud, labels=labels)
    fine = bench.judge(bench.local, cloud=cloud, by_labels=False)
    assert fine.explained > 0.8
    assert "far off" not in fine.sentence
    shuffled = replace(cloud, motion=bench.cloud.motion[:, ::-1])
    weak = bench.judge(bench.local, cloud=shuffled, by_labels=False)
    assert weak.explained < 0.5
    assert f"shapes explain {weak.explained:.0%} of it: all markers may be far off" in weak.sentence
