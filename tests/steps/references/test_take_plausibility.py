"""Where a take meets a rig, takes that ingest has not judged are judged, and the rig is."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.model.placement.test_plausibility import synthetic, with_sides_exchanged
from tests.model.placement.test_rig_orientation import transformed
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.demo.rig import demo_rig
from usdface.steps.inputs.cleaned_takes import (
    plausibility_notes,
    read_cleaned_takes,
    take_warnings,
)
from usdface.usdio.take.read import TakeReader
from usdface.usdio.take.write import write_take


def cleaned(
    path: Path, markers: Markers, warnings: tuple[str, ...] | None, *, name: str = "x"
) -> Path:
    """Write a take whose head stands still, as `clean` leaves it."""
    still = replace(
        markers,
        positions=np.repeat(markers.positions[:1], 60, axis=0)
        + np.random.default_rng(0).normal(0, 0.1, (60, len(markers.names), 3)).astype(np.float32),
        visible=markers.visible[:60],
        confidence=markers.confidence[:60],
        rigid=("NoseTop", "NoseHead", "ForeHead_M", "ForeHead_L"),
        neutral_frame=1,
        space="stabilized",
    )
    write_take(path, Take(name, Fraction(60), 1, still, warnings=warnings), provenance=Provenance())
    return path


def test_warnings_of_ingest_are_repeated_and_nothing_is_judged_again(tmp_path: Path) -> None:
    wrong = with_sides_exchanged(synthetic())
    path = cleaned(tmp_path / "x.clean.take.usda", wrong, ("left and right ...",))
    takes = read_cleaned_takes((path,))
    assert plausibility_notes(takes, (path,), demo_rig()) == ["x: left and right ..."]
    assert take_warnings(TakeReader(path)) == ["left and right ..."]


def test_takes_of_other_tools_are_judged_where_they_meet_a_rig(tmp_path: Path) -> None:
    path = cleaned(tmp_path / "x.clean.take.usda", with_sides_exchanged(synthetic()), None)
    message = r"x\.clean\.take\.usda: left and right are exchanged: .*ingest it again and name"
    with pytest.raises(InputError, match=message):
        plausibility_notes(read_cleaned_takes((path,)), (path,), demo_rig())
    with pytest.raises(InputError, match=message):
        take_warnings(TakeReader(path))


def test_takes_of_one_select_have_one_size(tmp_path: Path) -> None:
    paths = []
    for name, scale in (("a", 1.0), ("b", 1.0), ("c", 0.1)):
        markers = synthetic()
        sized = replace(markers, positions=np.float32(scale) * markers.positions)
        paths.append(cleaned(tmp_path / f"{name}.take.usda", sized, ("stated",), name=name))

    def notes_of(*chosen: Path) -> list[str]:
        return plausibility_notes(read_cleaned_takes(chosen), chosen, demo_rig())

    assert notes_of(paths[0], paths[1]) == ["a: stated", "b: stated"]
    with pytest.raises(InputError, match=r"c\.take\.usda.* 0\.1.* times"):
        notes_of(paths[0], paths[2])


def test_a_face_meets_a_rig_that_stands(tmp_path: Path) -> None:
    path = cleaned(tmp_path / "x.clean.take.usda", synthetic(), None)
    takes = read_cleaned_takes((path,))
    assert plausibility_notes(takes, (path,), demo_rig()) == []
    with pytest.raises(InputError, match="the head lies"):
        plausibility_notes(takes, (path,), transformed(demo_rig(), np.diag([1.0, -1, -1])))
    (note,) = plausibility_notes(takes, (path,), transformed(demo_rig(), np.diag([-1.0, 1, 1])))
    assert "move the right side of the rig" in note
