"""Markers that fall off the face during a take."""

from dataclasses import replace

import pytest

from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take


@pytest.mark.parametrize(
    ("mm", "max_gap"), [pytest.param(1000.0, None, marks=pytest.mark.slow), (60.0, 5)]
)
def test_a_marker_that_falls_off_is_named_with_its_frames(
    shot: Shot, mm: float, max_gap: int | None
) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    positions, marker = take.markers.positions.copy(), len(take.markers.names) - 1
    positions[-40:, marker, 1] -= mm
    fallen = replace(take, markers=replace(take.markers, positions=positions))
    write_take(shot / "fallen.take.usda", fallen, provenance=Provenance())
    result = execute(
        CleanSpec(
            take=shot / "fallen.take.usda", out=shot / "fallen.clean.take.usda", max_gap=max_gap
        )
    )
    (note,) = (note for note in result.notes if note.startswith("left the face"))
    last = take.first_frame + take.frame_count - 1
    assert take.markers.names[marker] in note
    assert f"-{last})" in note
    assert result.figures["lost"] >= 40
    assert ("too long to fill" in note) == (max_gap is not None)
    advice = [each for each in result.notes if "raise --max-gap" in each]
    assert not any(take.markers.names[marker] in each for each in advice)


def test_a_marker_that_is_never_seen_is_named(shot: Shot) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    visible, name = take.markers.visible.copy(), take.markers.names[-1]
    visible[:, -1] = False
    markers = replace(take.markers, visible=visible, confidence=visible.astype("float32"))
    write_take(shot / "less.take.usda", replace(take, markers=markers), provenance=Provenance())
    with pytest.raises(InputError, match=f"never shows 1 marker, {name}; ingest the capture again"):
        execute(CleanSpec(take=shot / "less.take.usda", out=shot / "less.clean.take.usda"))
