"""Labels of optical markers may be swapped, those of landmarks, which a model names, cannot."""

from dataclasses import replace

from tests.steps.small_shot import Shot
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

PAIR, FRAMES = ("lip_lower_R1", "lip_lower_R2"), slice(200, 240)


def notes_of(shot: Shot, *, landmarks: bool) -> str:
    """Clean the shot's take with two labels exchanged, and return the notes."""
    take = read_take(shot / "shot.take.usda")
    markers = take.markers
    assert markers is not None
    positions = markers.positions.copy()
    pair = [markers.names.index(name) for name in PAIR]
    positions[FRAMES, pair] = positions[FRAMES, pair[::-1]]
    names = [f"landmark_{name}" for name in markers.names] if landmarks else markers.names
    rigid = tuple(names[markers.names.index(name)] for name in markers.rigid)
    swapped = replace(markers, names=tuple(names), rigid=rigid, positions=positions)
    file = shot / "swapped.take.usda"
    write_take(file, replace(take, markers=swapped, video=None), provenance=Provenance())
    return " ".join(execute(CleanSpec(take=file, out=shot / "swapped.clean.take.usda")).notes)


def test_markers_are_relabelled(shot: Shot) -> None:
    assert "labels lip_lower_R1 and lip_lower_R2 were swapped" in notes_of(shot, landmarks=False)


def test_landmarks_are_not(shot: Shot) -> None:
    assert "swapped" not in notes_of(shot, landmarks=True)
