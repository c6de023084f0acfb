"""Takes whose markers never move: cleaned with a note that says so, and refused as references."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec
from usdface.specs.references import SelectSpec
from usdface.steps.capture import clean as clean_step
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take


def write_still(path: Path, markers: int, *, noise_mm: float = 0.0, turning: bool = False) -> None:
    """Write a take of points on half a cylinder, the size of a face, that hold one place."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(-1.3, 1.3, markers)
    face = np.stack([80 * np.sin(angle), rng.uniform(-90, 90, markers), 80 * np.cos(angle)], axis=1)
    positions = np.repeat(face[None], 60, axis=0)
    if turning:
        turn = 0.2 * np.sin(np.linspace(0, np.pi, 60))
        x, z = positions[..., 0].copy(), positions[..., 2].copy()
        cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
        positions[..., 0], positions[..., 2] = cosine * x + sine * z, cosine * z - sine * x
    positions += rng.normal(0, noise_mm, positions.shape)
    visible = np.ones((60, markers), bool)
    visible[20:30, ::7] = False
    still = Markers(
        names=tuple(f"m{index}" for index in range(markers)),
        positions=positions.astype(np.float32),
        visible=visible,
        confidence=visible.astype(np.float32),
        neutral_frame=1,
    )
    write_take(
        path,
        Take(name="still", rate=Fraction(60), first_frame=1, markers=still),
        provenance=Provenance(),
    )


@pytest.mark.parametrize(
    ("markers", "noise_mm", "turning"),
    [pytest.param(400, 0.0, False, marks=pytest.mark.slow), (60, 0.1, False), (60, 0.0, True)],
    ids=["400 markers", "with noise", "on a head that turns"],
)
def test_a_still_face_is_cleaned_with_words_and_its_pairs_are_refused(
    shot: Shot, markers: int, noise_mm: float, turning: bool
) -> None:
    take, clean = shot / "still.take.usda", shot / "still.clean.take.usda"
    write_still(take, markers, noise_mm=noise_mm, turning=turning)
    notes = execute(CleanSpec(take=take, out=clean)).notes
    assert sum("no marker moves on the head" in note for note in notes) == 1
    assert all(len(note) < 600 for note in notes), "hundreds of names are no note"
    markers_in, markers_out = read_take(take).markers, read_take(clean).markers
    assert markers_out is not None
    assert markers_out.visible.all()
    if not turning:
        assert markers_in is not None
        away = np.abs(markers_out.positions - markers_in.positions[:1])
        assert away.max() < max(6 * noise_mm, 0.01)
    out = shot / "still.references.usda"
    spec = SelectSpec(takes=(clean,), rig=shot / "hero.usdc", count=4, out=out)
    with pytest.raises(InputError, match=r"no marker moves on the head .* give takes of a moving"):
        execute(spec)
    assert not out.exists()


@pytest.mark.parametrize(
    ("columns", "seconds"),
    [
        (slice(None), 0.02),  # one dropped frame
        (slice(None), 0.25),
        (slice(None), 2.2),  # more than half of the take
        (slice(3, 5), 0.07),  # a short gap that was filled
        (slice(3, 5), 1.0),
    ],
)
def test_markers_of_a_stream_that_froze_are_taken_for_unseen(
    shot: Shot, columns: slice, seconds: float
) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    count = int(seconds * float(take.rate))
    positions, visible = take.markers.positions.copy(), take.markers.visible.copy()
    positions[201 : 201 + count, columns] = positions[200, columns]
    visible[200 : 201 + count, columns] = True
    frozen = replace(take.markers, positions=positions, visible=visible)
    left, notes = clean_step._without_copies(frozen, take, frozen.neutral_frame)
    who = "every marker" if columns == slice(None) else first_few(take.markers.names[columns])
    first = take.first_frame + 201
    said = f"exactly one position for {count} frames ({first}-{first + count - 1}): {who}"
    assert any(said in note for note in notes)
    assert not left.visible[201 : 201 + count, columns].any()
    assert left.visible[150:200, columns].any()
    assert left.visible[201 : 201 + count].any() == (who != "every marker")


def test_a_take_written_at_twice_the_rate_of_its_capture_is_named(shot: Shot) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    first = np.arange(take.frame_count) // 2 * 2
    seen = take.markers.visible[first]
    held = replace(take.markers, positions=take.markers.positions[first], visible=seen)
    write_take(shot / "held.take.usda", replace(take, markers=held), provenance=Provenance())
    out = shot / "held.clean.take.usda"
    notes = execute(CleanSpec(take=shot / "held.take.usda", out=out)).notes
    said = f"captured at about {float(take.rate) / 2:g} frames per second and written at"
    assert any(said in note for note in notes)


def test_a_marker_that_is_stuck_is_named_and_does_not_hide_a_stream_that_froze(shot: Shot) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    positions, visible = take.markers.positions.copy(), take.markers.visible.copy()
    count = round(float(take.rate))
    positions[:, 7], visible[:, 7] = positions[0, 7], True
    positions[201 : 201 + count], visible[200 : 201 + count] = positions[200], True
    stuck = replace(take.markers, positions=positions, visible=visible)
    write_take(shot / "stuck.take.usda", replace(take, markers=stuck), provenance=Provenance())
    out = shot / "stuck.clean.take.usda"
    notes = execute(CleanSpec(take=shot / "stuck.take.usda", out=out, max_gap=0)).notes
    assert not any("no marker moves" in note for note in notes), "the face moves before"
    cleaned = read_take(out).markers
    assert cleaned is not None
    assert not np.delete(cleaned.visible[201 : 201 + count], 7, axis=1).any()
    assert cleaned.visible[150:200].any()
    assert any(f"most of the take: {take.markers.names[7]};" in note for note in notes)
    assert any(
        f"exactly one position for {count} frames" in note and "every marker" in note
        for note in notes
    )


def test_frames_that_show_no_marker_repeat_nothing(shot: Shot) -> None:
    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    visible = take.markers.visible.copy()
    visible[-len(visible) // 4 :] = False
    write_take(
        shot / "padded.take.usda",
        replace(take, markers=replace(take.markers, visible=visible)),
        provenance=Provenance(),
    )
    out = shot / "padded.clean.take.usda"
    notes = execute(CleanSpec(take=shot / "padded.take.usda", out=out)).notes
    assert not any("repeat the one before" in note for note in notes)
