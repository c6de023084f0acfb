"""The verdict on a solve: its level, its words, what to do."""

from dataclasses import replace

import numpy as np
import pytest

from usdface.core.assets import SolveBasis
from usdface.model.review.verdict import VISIBLE_ERROR_MM, SolveEvidence, judge_solve, worst_verdict

REGIONS = ("face", "brows", "mouth")
TUNED, PROPOSED = SolveBasis(50, 50), SolveBasis(30, 0, ("brows",))


def evidence(**values: float) -> SolveEvidence:
    """Make 100 frames of constant figures: covered, sure, tuned unless said otherwise."""
    given = {"uncertainty_mm": 0.1, "coverage": 0.95, "residual_mm": 0.0} | values
    return SolveEvidence(
        REGIONS, basis=TUNED, **{name: np.full((100, 3), value) for name, value in given.items()}
    )


@pytest.mark.parametrize(
    ("name", "value", "level"),
    [
        ("uncertainty_mm", 0.49 * VISIBLE_ERROR_MM, "good"),
        ("uncertainty_mm", 0.51 * VISIBLE_ERROR_MM, "check"),
        ("uncertainty_mm", 1.01 * VISIBLE_ERROR_MM, "bad"),
        ("residual_mm", 0.51 * VISIBLE_ERROR_MM, "check"),
        ("residual_mm", 1.01 * VISIBLE_ERROR_MM, "bad"),
        ("coverage", 0.74, "check"),
        ("coverage", 0.49, "bad"),
    ],
)
def test_a_figure_beyond_its_limit_sets_the_level(name: str, value: float, level: str) -> None:
    verdict = judge_solve(evidence(**{name: value}))
    assert verdict.level == level
    assert bool(verdict.advice) == (level != "good")


@pytest.mark.parametrize(
    ("frames", "level"), [(0, "good"), (5, "good"), (6, "check"), (50, "check"), (51, "bad")]
)
def test_the_level_of_a_take_is_that_of_most_frames(frames: int, level: str) -> None:
    found = evidence()
    found.coverage[:frames, 1] = 0.2
    verdict = judge_solve(found)
    assert verdict.level == level
    if level != "good":
        limit = "50%" if level == "bad" else "75%"
        counted = f"; coverage below {limit}: the brows in {frames}% of the frames"
        assert verdict.sentence.endswith(counted)


def test_a_take_of_brows_by_references_of_cheeks_is_red_and_says_why_and_what_to_do() -> None:
    found = replace(evidence(residual_mm=1.6), basis=PROPOSED)
    found.coverage[:] = [0.4, 0.35, 0.9]
    verdict = judge_solve(found)
    assert verdict.level == "bad"
    for words in (
        "cover 0% of the frames",
        "none of the 30 references is tuned",
        "residual 1.6 mm",
    ):
        assert words in verdict.sentence
    assert verdict.sentence.endswith(
        "; residual over 1 mm or coverage below 50%: the brows in 100% of the frames, "
        "the mouth in 100%"
    )
    assert verdict.advice == (
        "add frames of this take to the references, chosen for the brows and the mouth, and tune "
        "the references (30 are proposals), then train and map again"
    )


def test_the_limits_that_are_counted_are_those_of_the_level_and_of_the_figures() -> None:
    found = evidence()
    found.uncertainty_mm[:80, 2] = 0.6
    found.uncertainty_mm[:40, 2] = 1.1
    found.coverage[:3, 2] = 0.4
    verdict = judge_solve(found)
    assert verdict.sentence.endswith("; expected error over 0.5 mm: the mouth in 80% of the frames")
    found.uncertainty_mm[:60, 2] = 1.1
    verdict = judge_solve(found)
    assert verdict.sentence.endswith("; expected error over 1 mm: the mouth in 60% of the frames")
    keys = judge_solve(replace(found, error_mm=np.tile([0.3, 0.2, 0.7], (100, 1))))
    assert keys.sentence.endswith("; error over 0.5 mm: the mouth in 100% of the frames")


@pytest.mark.parametrize(("frames", "level"), [(4, "good"), (12, "bad")])
def test_a_mouth_that_is_torn_for_a_while_is_red_and_named(frames: int, level: str) -> None:
    found = evidence()
    found.uncertainty_mm[:frames, 2] = 8.0
    found.uncertainty_mm[:40, 1] = 0.6 if level == "bad" else 0.1
    verdict = judge_solve(found)
    assert verdict.level == level
    if level == "bad":
        counted = f"; expected error over 3 mm: the mouth in {frames}% of the frames"
        assert verdict.sentence.endswith(counted)


def test_motion_that_a_retargeting_lost_is_said_beside_the_error() -> None:
    found = replace(
        evidence(),
        uncertainty_mm=None,
        residual_mm=None,
        coverage=None,
        basis=None,
        by_markers=False,
        error_mm=np.full((100, 3), 0.7),
        retarget="mouthPucker and 3 more are not followed",
        unfollowed_share=0.3,
    )
    verdict = judge_solve(found)
    assert verdict.sentence.startswith("Check: mouthPucker and 3 more are not followed; 0.70 mm")
    assert verdict.advice.startswith("give these shapes counterparts")
    small = judge_solve(replace(found, unfollowed_share=0.01))
    assert "mouthPucker" not in small.sentence


def test_proposals_are_never_good() -> None:
    proposed = judge_solve(replace(evidence(), basis=PROPOSED))
    assert proposed.level == "check"
    tuned = judge_solve(replace(evidence(), basis=SolveBasis(30, 15)))
    assert tuned.level == "good"


def test_a_take_that_its_proposals_cover_is_tuned_before_more_frames_are_added() -> None:
    found = replace(evidence(uncertainty_mm=1.3), basis=PROPOSED)
    verdict = judge_solve(found)
    assert verdict.level == "bad"
    assert verdict.advice == "tune the references (30 are proposals), then train and map again"
    by_keys = judge_solve(replace(found, error_mm=found.uncertainty_mm))
    assert (by_keys.level, by_keys.advice) == ("bad", verdict.advice)
    far = judge_solve(replace(found, residual_mm=np.full_like(found.uncertainty_mm, 1.6)))
    assert far.advice.startswith("add frames of this take")


def test_a_solve_on_a_rig_without_shapes_for_a_region_is_not_good() -> None:
    basis = SolveBasis(30, 30, regions_without_shapes=("mouth", "jaw"))
    verdict = judge_solve(replace(evidence(), basis=basis))
    assert verdict.level == "check"
    assert "the rig has no shapes for the mouth and the jaw: their markers" in verdict.sentence
    assert judge_solve(replace(evidence(), basis=SolveBasis(30, 30))).level == "good"


@pytest.mark.parametrize(
    ("scale", "uncertainty_mm", "level", "limit"),
    [
        (0.1, 0.2, "bad", "0.1"),
        (6.0, 2.5, "good", ""),
        (6.0, 7.0, "bad", "6"),
        (1.5, 1.2, "bad", "1"),
    ],
)
def test_errors_on_a_giant_or_a_dwarf_are_judged_in_proportion(
    scale: float, uncertainty_mm: float, level: str, limit: str
) -> None:
    basis = SolveBasis(30, 30, motion_scale=scale)
    verdict = judge_solve(replace(evidence(uncertainty_mm=uncertainty_mm), basis=basis))
    assert verdict.level == level
    assert f"expected error over {limit} mm" in verdict.sentence or not limit


def test_residuals_are_the_performers_on_any_rig() -> None:
    basis = SolveBasis(30, 30, motion_scale=6.0)
    found = replace(evidence(), residual_mm=np.full((100, 3), 1.2), basis=basis)
    assert "residual over 1 mm" in judge_solve(found).sentence


def test_references_of_regions_without_markers_are_not_asked_for() -> None:
    basis = SolveBasis(30, 30, still_regions=("mouth",), regions_without_markers=("mouth",))
    found = replace(evidence(), basis=basis)
    found.uncertainty_mm[:, 2] = 4.0
    verdict = judge_solve(found)
    assert verdict.level == "bad"
    assert "no marker sees the mouth: weights there are guessed" in verdict.sentence
    assert verdict.advice == "use the rest of the face alone, or capture the mouth with markers"
    found.uncertainty_mm[:, 1] = 3.0
    assert "chosen for the brows, then" in judge_solve(found).advice
    mine = replace(found, error_mm=np.full((100, 3), 4.0))
    assert "no marker sees" not in judge_solve(mine).sentence


def test_a_solve_onto_other_shapes_than_those_of_the_training_is_not_good() -> None:
    basis = SolveBasis(50, 50, changed_shapes=("jawOpen", "mouthClose", "browDown"))
    verdict = judge_solve(replace(evidence(), basis=basis))
    assert verdict.level == "check"
    assert "changed since training: jawOpen, mouthClose and 1 more" in verdict.sentence
    assert verdict.advice == "tune the pairs that show them again, then train and map again"


def test_keys_decide_where_they_are_known() -> None:
    found = evidence(uncertainty_mm=9.0, coverage=0.1)
    for error_mm, level in ((0.2, "good"), (0.6, "check"), (1.2, "bad")):
        error = np.full((100, 3), error_mm)
        error[3:] = np.nan  # keys of some frames alone
        verdict = judge_solve(replace(found, error_mm=error))
        assert verdict.level == level
        assert f"{error_mm:.2f} mm off the keys" in verdict.sentence
        assert "references cover 0% of the frames;" in verdict.sentence


def test_nothing_known_is_not_good() -> None:
    verdict = judge_solve(SolveEvidence(()))
    assert (verdict.level, "no record of its references" in verdict.sentence) == ("check", True)
    assert verdict.advice.startswith("map it with a mapping, or"), "a baseline is of this version"


def test_weights_of_others_say_what_they_are_and_name_a_video_only_where_there_is_one() -> None:
    phone = SolveEvidence((), by_markers=False)
    verdict = judge_solve(phone)
    assert "weights of another solver" in verdict.sentence
    assert verdict.advice == "measure against keys (--against)"
    seen = judge_solve(replace(phone, has_video=True))
    assert seen.advice.startswith("compare with the video, or measure")
    ours = judge_solve(SolveEvidence((), retarget="a retarget of 50 pairs, none of them tuned"))
    assert ours.sentence.startswith("Check: a retarget of 50 pairs, none of them tuned; ")
    assert "another solver" not in ours.sentence


def test_an_earlier_version_knew_the_face_alone() -> None:
    found = SolveEvidence(REGIONS, uncertainty_mm=np.full((100, 1), 2.0))
    assert judge_solve(found).level == "bad"


def test_of_several_solves_the_worst_is_the_verdict_and_names_whose() -> None:
    good, bad = judge_solve(evidence()), judge_solve(evidence(coverage=0.1))
    worst = worst_verdict({"solve": good, "dog": bad, "cat": good})
    assert worst.level == "bad"
    assert worst.sentence.startswith("Do not use (dog): references cover 0% of the frames")
    assert (worst.advice, worst.figures["of"]) == (bad.advice, "dog")
    assert worst_verdict({"solve": good}) == good
