"""What is proposed for lids, by what the markers show of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from tests.model.selection.test_baseline import bent_equation
from usdface.capture.sniff import read_capture
from usdface.core.deformer import Deformer
from usdface.model.placement.label_hints import skin_motion_mm
from usdface.model.selection.baseline import (
    BlendshapeEquation,
    PerformerMarkers,
    set_up_equation,
)
from usdface.model.selection.lid_evidence import LidEvidence, find_lid_evidence
from usdface.numerics.repair.cleaning import clean_markers
from usdface.numerics.solve.peak_matching import ShapeEvidence
from usdface.usdio.rig.read import read_rig

NAMES = ("jawOpen", "eyeBlink_L", "eyeBlink_R")


def lids(
    marked: tuple[bool, bool], peaks: tuple[float, float], alone: tuple[bool, bool] = (False, False)
) -> LidEvidence:
    seen = ShapeEvidence(np.array(marked), np.array(peaks), np.array(alone))
    return LidEvidence((1, 2), seen, (3,))


@pytest.mark.parametrize(
    ("evidence", "closing", "fixed", "tied", "words"),
    [
        (lids((True, True), (0.6, 0.5)), (1, 2), (), (), ""),
        (lids((True, True), (0.2, 0.1)), (), (1, 2, 3), (), "show no blinks: of a full blink, 15%"),
        (lids((True, True), (0.396, 0.4)), (), (1, 2, 3), (), "of a full blink, 39% is in"),
        (lids((True, True), (0.5, 0.1), (True, False)), (1, 2), (), (), ""),
        (lids((True, True), (0.5, 0.1)), (), (1, 2, 3), (), "of a full blink, 30% is in"),
        (lids((True, False), (0.6, 0.1)), (1,), (), ((1, 2),), "on the lid of eyeBlink_R:"),
        (lids((False, False), (0.9, 0.9)), (), (3,), ((1, 2),), "both eyes alike"),
    ],
)
def test_what_markers_show_decides_how_lids_are_solved(
    evidence: LidEvidence,
    closing: tuple[int, ...],
    fixed: tuple[int, ...],
    tied: tuple[tuple[int, ...], ...],
    words: str,
) -> None:
    assert (evidence.closing, evidence.fixed, evidence.tied) == (closing, fixed, tied)
    assert words in evidence.note(NAMES)
    assert bool(words) == bool(evidence.note(NAMES))


def test_a_lid_marker_in_the_fold_counts_by_its_label() -> None:
    """One lid alone reached the limit on a recorded performer without blinks."""
    one = lids((False, True), (0.2, 0.45))
    assert one.closing == (2,)
    both = replace(one, seen=replace(one.seen, labelled=np.array([True, True])))
    assert (both.closing, both.fixed) == ((), (1, 2, 3))
    assert "of a full blink, 32% is in" in both.note(NAMES)


def test_a_difference_between_takes_is_no_blink() -> None:
    """Lids of one take lie lower than those of the other, by another head pose or expression."""
    rng = np.random.default_rng(0)
    offsets = np.zeros((3, 12, 3))
    offsets[1, :2, 1] = offsets[2, 2:4, 1] = -8.0
    takes = [rng.normal(0, 0.3, (frames, 12, 3)) for frames in (400, 150)]
    takes[1][:, :4, 1] -= 4.0
    known = (NAMES, sparse.csr_array(offsets.reshape(3, -1)), offsets)
    assert find_lid_evidence(*known, [np.concatenate(takes)], np.ones(12)).seen.shown
    assert not find_lid_evidence(*known, takes, np.ones(12)).seen.shown


def test_lids_without_evidence_stay_at_rest_and_lids_without_marker_follow() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    seen = equation.neutral + shapes.offsets(weights)
    solved = {}
    for name, evidence in (
        ("rest", lids((True, True), (0, 0))),
        ("tied", lids((True, False), (1, 0))),
    ):
        known = {**vars(equation), "lids": replace(evidence, gaze=())}
        solved[name] = BlendshapeEquation(**known).propose(seen)
    assert (solved["rest"][:, 1:] == 0).all()
    assert (solved["rest"][:, 0] > 0).any()
    np.testing.assert_array_equal(solved["tied"][:, 1], solved["tied"][:, 2])
    assert (solved["tied"][:, 1] > 0).all()


@pytest.mark.parametrize(
    ("names", "blinks", "gaze"),
    [
        (("eyeLookDown_L", "eyeBlink_R", "jawOpen", "eyeBlink_L"), (1, 3), (0,)),
        (("rig2_eyeBlink_L", "rig2_eyeBlink_R", "rig2_eyeLookIn_L"), (0, 1), (2,)),
        (("l_eye_close", "r_eye_close", "eyes_closed", "l_eyeBall_up"), (0, 1), (3,)),
        (("Blink", "Jaw_Drop"), (0,), ()),
        (("Jaw_Drop",), (), ()),
    ],
)
def test_shapes_of_the_eyes_are_known_by_what_their_names_mean(
    names: tuple[str, ...], blinks: tuple[int, ...], gaze: tuple[int, ...]
) -> None:
    still = np.zeros((len(names), 4, 3))
    evidence = find_lid_evidence(
        names,
        sparse.csr_array((len(names), 12)),
        still,
        [np.zeros((9, 4, 3))],
        np.ones(4),
    )
    assert (evidence.shapes, evidence.gaze) == (blinks, gaze)


@pytest.mark.slow
@pytest.mark.fixtures("markers_animface", "rigs")
def test_a_recorded_brow_take_shows_no_blinks(shared_data) -> None:
    markers = read_capture(shared_data / "markers_animface" / "EyebrowsMoCap.c3d").take.markers
    positions, prior = markers.positions.astype(float), skin_motion_mm(markers.names)
    seen, still = np.ones(positions.shape[:2], bool), np.flatnonzero(np.array(prior) <= 1.0)
    cleaned = clean_markers(
        positions, seen, rigid=still.tolist(), neutral=0, skin_motion_mm=prior
    ).positions.astype(float)
    rig = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    equation = set_up_equation(
        rig,
        Deformer(rig),
        PerformerMarkers(
            neutral=cleaned[0], positions=cleaned, visible=seen, rigid=(), labels=markers.names
        ),
    )
    assert equation.lids is not None
    left = [rig.shapes[shape] for shape in equation.lids.fixed]
    assert left[:2] == ["eyeBlink_L", "eyeBlink_R"]
    assert len(left) == 10
    assert all(name.startswith("eyeLook") for name in left[2:])
    assert equation.lids.seen.independent_peaks.max() < 0.25
    np.testing.assert_array_equal(equation.gain, 1.0)
    weights = equation.propose(cleaned[::10])
    brows = [i for i, name in enumerate(rig.shapes) if name.startswith("brow")]
    assert weights[:, brows].max() > 0.5
