"""Layers that people write count as inputs: the same command runs again after they change."""

import os
from pathlib import Path

import pytest

from tests.steps.small_shot import Shot
from usdface.core.provenance import Provenance
from usdface.core.sidecars import corrected_path, placement_path, tuned_path
from usdface.runner.execute import execute
from usdface.runner.origin import make_provenance
from usdface.runner.state import StepState, step_state
from usdface.specs.base import Spec
from usdface.specs.reading import read_job
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.binding import correct_binding

pytestmark = pytest.mark.usefixtures(
    "without_comparison", "placement_not_drawn", "coverage_not_drawn"
)


def step(shot: Shot, name: str) -> Spec:
    return next(each for each in read_job(shot / "shot.job.yaml").steps if each.step == name)


def state(spec: Spec) -> StepState:
    return step_state(spec, make_provenance(spec))


def make_newest(path: Path) -> None:
    """Set the time of a layer's change after those of all outputs, as if an hour had passed."""
    later = path.stat().st_mtime + 3600
    os.utime(path, (later, later))


def correct(shot: Shot, marker: str, point: int | None) -> None:
    placement = placement_path(shot / "hero.references.usda")
    points = rig_surfaces(read_rig(shot / "hero.usdc"))[0].mesh.points
    place = None if point is None else points[point]
    made = Provenance(step="tune", spec="{}", inputs={})
    correct_binding(placement, {marker: place}, made)
    make_newest(corrected_path(placement))


def test_selecting_again_after_a_correction_places_and_proposes_again(shot: Shot) -> None:
    spec = step(shot, "select")
    assert state(spec).state == "done", "the empty layer of corrections changes nothing"
    correct(shot, "cheek_L3", 700)
    stale = state(spec)
    assert (stale.state, "placement.corrected.usda" in stale.reason) == ("stale", True)
    again = execute(spec)
    assert not again.up_to_date
    assert again.figures["placement"]["placed_by_a_person"] == 1
    assert state(spec).state == "done"
    correct(shot, "cheek_L3", None)
    assert state(spec).state == "stale", "a correction that is removed counts as well"
    assert execute(spec).figures["placement"]["placed_by_a_person"] == 0
    assert state(spec).state == "done"


def test_training_again_after_pairs_were_tuned_needs_no_permission(shot: Shot) -> None:
    spec = step(shot, "train")
    tuned = tuned_path(shot / "hero.references.usda")
    text = tuned.read_text()
    tuned.write_text(text.replace("0.", "0.1", 1))
    make_newest(tuned)
    assert "hero.references.usda has changed" in state(spec).reason
    assert not execute(spec).up_to_date
