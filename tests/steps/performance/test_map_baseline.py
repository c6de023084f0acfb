"""The blendshape equation as a performance: `map --baseline`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.specs.performance import MapSpec
from usdface.steps.inputs.cleaned_takes import read_cleaned
from usdface.steps.inputs.solve_verdict import verdict_findings
from usdface.steps.review.scoring import set_up_shot_baseline
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import read_performance
from usdface.usdio.take.write import write_take


def solved(shot: Shot, out: Path, **options: object) -> np.ndarray:
    spec = {"take": shot / "shot.clean.take.usda", "rig": shot / "hero.usdc", "out": out}
    execute(MapSpec(baseline=True, **spec | options))
    return read_performance(out).weights.values


def test_a_baseline_is_what_sheets_show_and_unlimited_is_plain_least_squares(
    finished_shot: Shot, tmp_path: Path
) -> None:
    placement = finished_shot / "hero.references.placement.usda"
    bounded = solved(finished_shot, tmp_path / "b.usda", placement=placement)
    free = solved(finished_shot, tmp_path / "u.usda", placement=placement, unlimited=True)
    shot = open_shot(finished_shot / "shot.hero.usda", finished_shot / "shot.clean.take.usda")
    equation = set_up_shot_baseline(shot)
    np.testing.assert_allclose(bounded, equation.propose(shot.positions), atol=1e-6)
    rotation, scale = equation.virtual.rotation, equation.virtual.motion_scale
    moved = scale * (shot.positions - equation.neutral) @ rotation.T
    matrix = equation.deltas.reshape(len(equation.deltas), -1).T
    for frame in (50, 200, 400):  # eq. 7, frame by frame
        direct = np.linalg.lstsq(matrix, moved[frame].ravel())[0]
        np.testing.assert_allclose(free[frame], direct, atol=1e-4 * np.abs(direct).max())
    assert free.min() < -0.05
    assert bounded.min() >= 0.0
    assert bounded.max() <= 1.0


def test_a_stretch_of_frames_is_solved_as_the_whole_take(
    finished_shot: Shot, tmp_path: Path
) -> None:
    whole = solved(finished_shot, tmp_path / "whole.usda")
    part = solved(finished_shot, tmp_path / "part.usda", frames="101-140")
    np.testing.assert_allclose(part, whole[100:140], atol=1e-6)
    (finding,) = verdict_findings(tmp_path / "whole.usda")
    assert finding.severity == "warning"
    assert "Check: this solve has no record of its references or its error" in finding.message


def test_a_doubtful_placement_is_said(finished_shot: Shot, tmp_path: Path) -> None:
    take = read_cleaned(finished_shot / "shot.clean.take.usda")
    assert take.markers is not None
    names = tuple(f"m{each}" for each in range(len(take.markers.names)))
    unnamed = replace(take.markers, names=names, rigid=names[:4])
    write_take(tmp_path / "m.take.usda", replace(take, markers=unnamed), provenance=Provenance())
    given = {"take": tmp_path / "m.take.usda", "rig": finished_shot / "hero.usdc", "frames": "1-9"}
    spec = MapSpec(baseline=True, out=tmp_path / "m.usda", **given)
    (note,) = (each for each in execute(spec).notes if each.startswith("placement: "))
    assert "placed by motion alone" in note
    assert "give it as --placement" in note


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give --mapping, or --baseline"),
        ({"mapping": "m.usdc", "baseline": True}, "give --mapping, or --baseline"),
        ({"mapping": "m.usdc", "unlimited": True}, "unlimited has no effect without baseline"),
        ({"baseline": True, "temporal": "whole"}, "temporal has no effect with baseline"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        MapSpec(take="x.take.usda", rig="rig.usd", out="x.usda", **options)
