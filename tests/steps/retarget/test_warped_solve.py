"""A warp of a solve: the frames outside keep what is known of them, and what stops a publish."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.cli import main
from usdface.steps.inputs.solve_verdict import judge_performance
from usdface.usdio.performance.read import PerformanceReader


def usdface(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(each) for each in arguments])
    return int(stopped.value.code or 0)


def test_a_warped_solve_is_judged_by_the_frames_that_it_keeps(
    shot: Shot, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shot.folder)
    solve = "shot.hero.usda"
    make = ("make-sequence", "--source", solve, "--target", solve, "--label", "joy")
    ranges = ("--source-frames", "100-140", "--target-frames", "200-240")
    assert usdface(*make, *ranges, "--out", "joy.sequence.usda") == 0
    find = ("find-sequences", solve, "--sequence", "joy.sequence.usda", "--by", "label")
    assert usdface(*find, "--label", "joy", "--out", "m.usda") == 0
    capsys.readouterr()
    warp = ("warp", solve, "--matches", "m.usda", "--blend", 8, "--out", "warped.usda", "--json")
    assert usdface(*warp) == 0
    shown = json.loads(capsys.readouterr().out)
    before, after = PerformanceReader(Path(solve)), PerformanceReader(Path("warped.usda"))
    assert (after.regions, after.basis) == (before.regions, before.basis)
    outside = np.r_[: 100 - 8 - 1, 140 + 8 : len(before.frames)]
    for old, new, limit in zip(before.figures(), after.figures(), (0.02, 0.004, 0.02), strict=True):
        np.testing.assert_allclose(new[outside], old[outside], atol=limit)
    verdict = judge_performance(after)
    assert verdict.level == judge_performance(before).level
    assert shown["figures"]["verdict"]["level"] == verdict.level
