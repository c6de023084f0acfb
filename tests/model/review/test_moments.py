"""Moments to review first: ranking, merging, reasons."""

from dataclasses import replace

import numpy as np

from usdface.model.review.moments import (
    MOMENT_SECONDS,
    ReviewSignals,
    region_distances,
    review_moments,
    surface_jumps,
)
from usdface.model.review.verdict import SolveEvidence

REGIONS = ("face", "brows", "mouth")


def signals(frames: int = 600) -> ReviewSignals:
    """Return figures that differ from frame to frame."""
    rng = np.random.default_rng(0)
    uncertainty, coverage = rng.uniform(0.1, 0.3, (2, frames, 3))
    evidence = SolveEvidence(REGIONS, uncertainty_mm=uncertainty, coverage=coverage + 0.7)
    return ReviewSignals(evidence, np.zeros((frames, 3)))


def test_moments_are_the_largest_that_are_a_quarter_of_a_second_apart() -> None:
    found = signals()
    moments = review_moments(found, 12, rate=60.0)
    rows = [moment.row for moment in moments]
    score, wanted = found.score_mm, list[int]()
    for row in sorted(range(len(score)), key=lambda row: -score[row]):
        if len(wanted) < 12 and all(abs(row - other) >= 60 * MOMENT_SECONDS for other in wanted):
            wanted.append(row)
    assert rows == wanted
    assert len(review_moments(found, 1000, rate=60.0)) <= 600 / 15 * 2


def test_known_errors_find_all_of_the_worst_moments() -> None:
    found = signals()
    error = np.full((600, 3), 0.05)
    error[[30, 200, 450], 0], error[[30, 200, 450], 2] = 1.0, 2.0
    error[100:110] = np.nan  # without keys
    moments = review_moments(
        replace(found, evidence=replace(found.evidence, error_mm=error)), 3, rate=60.0
    )
    assert sorted(moment.row for moment in moments) == [30, 200, 450]
    assert {(moment.region, moment.reason) for moment in moments} == {
        ("mouth", "2.00 mm off the keys")
    }


def test_each_cause_is_found_and_named() -> None:
    found = signals()
    found.evidence.uncertainty_mm[100, [0, 1]] = 2.0
    weights = np.zeros((600, 4))
    weights[300, 3] = 1.0
    grams = np.zeros((3, 4, 4))
    grams[0, 3, 3], grams[2, 3, 3] = 9.0, 25.0  # 3 mm on the face, 5 on the mouth
    gap = np.zeros(600)
    gap[500], gap[100], gap[300] = 2.5, 0.04, 0.2
    found = replace(found, jump_mm=surface_jumps(weights, grams), gap_mm=gap)
    moments = {m.row: m for m in review_moments(found, 3, rate=60.0)}
    assert set(moments) == {100, 300, 500}
    assert (moments[100].region, moments[100].reason[:11]) == ("brows", "uncertainty")
    assert "lips" not in moments[100].reason  # nobody sees a gap of .04 mm
    assert (moments[300].region, moments[300].reason) == (
        "mouth",
        "jumps by 5.00 mm, lips 0.2 mm open, the performer's closed",
    )
    assert (moments[500].region, moments[500].reason[:16]) == ("mouth", "lips 2.5 mm open")


def test_coverage_is_part_of_the_uncertainty_and_does_not_rank_twice() -> None:
    found = signals()
    before = found.score_mm
    found.evidence.coverage[::2] = 0.01
    np.testing.assert_array_equal(found.score_mm, before)


def test_a_steady_motion_does_not_jump_and_distances_are_those_of_the_gram() -> None:
    rng = np.random.default_rng(1)
    half = rng.normal(size=(5, 12))
    weights = np.outer(np.arange(50), rng.normal(size=5))
    assert surface_jumps(weights, (half @ half.T)[None]).max() < 1e-9
    off = rng.normal(size=(7, 5))
    moved = np.linalg.norm(off @ half, axis=1)
    np.testing.assert_allclose(region_distances(off, (half @ half.T)[None])[:, 0], moved)


def test_jumps_that_nobody_sees_are_no_moments() -> None:
    jumps = np.zeros((600, 3))
    jumps[[100, 300, 500], 0] = [0.3, 0.04, 0.2]
    known = signals()
    evidence = replace(known.evidence, uncertainty_mm=None, error_mm=None, coverage=None)
    found = replace(known, evidence=evidence, jump_mm=jumps, gap_mm=None)
    assert [each.row for each in review_moments(found, 12, rate=60.0)] == [100, 500]
    still = replace(found, jump_mm=np.zeros((600, 3)))
    assert len(review_moments(still, 12, rate=60.0)) == 1, "something to look at"
