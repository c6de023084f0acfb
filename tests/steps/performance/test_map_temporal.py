"""Weights smoothed over time by the map step."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.specs.performance import MapSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take


def mapped(shot: Shot, out: Path, **options: object) -> np.ndarray:
    told = {"take": shot / "shot.clean.take.usda", "out": out} | options
    execute(MapSpec(mapping=shot / "hero.mapping.usdc", rig=shot / "hero.usdc", **told))
    return read_performance(out).weights.values


def test_temporal_modes_calm_a_shot_and_frames_do_not_depend_on_the_range(
    finished_shot: Shot, tmp_path: Path
) -> None:
    plain = mapped(finished_shot, tmp_path / "plain.usda")
    rough = np.abs(np.diff(plain, 3, axis=0)).mean()
    for mode in ("whole", "causal"):
        calm = mapped(finished_shot, tmp_path / f"{mode}.usda", temporal=mode, cutoff=12.0)
        assert np.abs(np.diff(calm, 3, axis=0)).mean() < 0.9 * rough
        part = mapped(
            finished_shot, tmp_path / f"{mode}2.usda", temporal=mode, cutoff=12.0, frames="101-200"
        )
        np.testing.assert_array_equal(part, calm[100:200])


def test_a_take_of_24_frames_per_second_is_smoothed_without_being_told_a_cutoff(
    finished_shot: Shot, tmp_path: Path
) -> None:
    slow = tmp_path / "slow.clean.take.usda"
    take = read_take(finished_shot / "shot.clean.take.usda")
    write_take(
        slow, replace(take, rate=Fraction(24), video=None, audio=None), provenance=Provenance()
    )
    plain = mapped(finished_shot, tmp_path / "plain.usda", take=slow)
    calm = mapped(finished_shot, tmp_path / "calm.usda", take=slow, temporal="whole")
    assert np.abs(np.diff(calm, 3, axis=0)).mean() < 0.9 * np.abs(np.diff(plain, 3, axis=0)).mean()


def test_residuals_are_told_for_each_part_of_the_face(finished_shot: Shot) -> None:
    performance = read_performance(finished_shot / "shot.hero.usda")
    assert performance.regions[0] == "face"
    assert {"brows", "lids", "mouth"} <= set(performance.regions)
    assert performance.residual_mm is not None
    assert performance.residual_mm.shape == (480, len(performance.regions))


def test_a_cutoff_that_the_rate_cannot_hold_is_refused(finished_shot: Shot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="half the rate of 120 frames per second, got 90 Hz"):
        mapped(finished_shot, tmp_path / "x.usda", temporal="whole", cutoff=90.0)
    assert not list(tmp_path.glob("x.*"))


def test_a_cutoff_that_leaves_nothing_is_refused(finished_shot: Shot, tmp_path: Path) -> None:
    for cutoff in (1e-3, 1e-90):
        with pytest.raises(InputError, match=r"must lie between 0\.012 Hz and half the rate"):
            mapped(finished_shot, tmp_path / "x.usda", temporal="whole", cutoff=cutoff)
