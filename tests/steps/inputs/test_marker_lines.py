"""Rows of markers along lips, lids and brows, in pictures and pages."""

import itertools
import json
import re

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.capture.face_landmarks import LANDMARK_ROWS, LANDMARKS
from usdface.core import deformer
from usdface.media.face.markers_view import draw_markers
from usdface.numerics.registration.face_skin import sample_face_skin
from usdface.runner.execute import execute
from usdface.specs.review import ReportSpec
from usdface.steps.inputs.marker_lines import lines_on_rig, marker_lines, rows_by_place
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.scoring import set_up_shot_baseline
from usdface.steps.review.shot import open_shot
from usdface.usdio.take.read import read_take

FACE = {
    "Mouth_Up": (0, 10, 9),
    "Mouth_UpL1": (15, 9, 7),
    "Mouth_UpR1": (-15, 9, 7),
    "Mouth_Lend": (25, 2, 0),
    "Mouth_Rend": (-25, 2, 0),
    "Mouth_Down": (0, -8, 8),
    "Leye_Up": (30, 75, 0),
    "Leye_Down": (31, 60, 0),
    "Leye_Inside": (16, 66, 2),
    "Leye_Outside": (46, 65, -4),
    "Reye_Up": (-30, 75, 0),
    "Leyebrow_M": (32, 95, 2),
    "Leyebrow_Inside": (14, 93, 6),
    "Leyebrow_Outside": (50, 88, -5),
    "Eyebrow_Center": (0, 94, 8),
    "Lcheek": (40, 30, 0),
    "M12": (20, -30, 0),
}


def joined(face: dict[str, tuple[float, float, float]]) -> set[frozenset[str]]:
    names = list(face)
    lines = marker_lines(names, np.array(list(face.values()), float))
    return {frozenset(names[end] for end in line) for line in lines.tolist()}


def chain(*names: str) -> set[frozenset[str]]:
    return {frozenset(pair) for pair in itertools.pairwise(names)}


def test_labels_tell_the_rows_and_places_their_order() -> None:
    expected = (
        chain("Mouth_Rend", "Mouth_UpR1", "Mouth_Up", "Mouth_UpL1", "Mouth_Lend")
        | chain("Mouth_Rend", "Mouth_Down", "Mouth_Lend")
        | chain("Leye_Inside", "Leye_Up", "Leye_Outside")
        | chain("Leye_Inside", "Leye_Down", "Leye_Outside")
        | chain("Leyebrow_Inside", "Leyebrow_M", "Leyebrow_Outside")
    )
    assert joined(FACE) == expected
    shuffled = dict(sorted(FACE.items(), key=lambda each: each[1][1]))
    assert joined(shuffled) == expected, "the order of the columns means nothing"


def test_what_is_silent_absent_or_of_two_rows_stays_dots() -> None:
    assert joined({f"M{i}": at for i, at in enumerate(FACE.values())}) == set()
    unseen = FACE | {"Mouth_Up": (np.nan,) * 3}
    assert frozenset({"Mouth_UpR1", "Mouth_UpL1"}) in joined(unseen), "its neighbours are joined"
    two_edges = {f"brow_L{i}": (8.0 * i, 90 + 12 * (i % 2), 0.0) for i in range(6)}
    assert joined(two_edges) == set(), "no zigzag"


def test_landmarks_of_a_video_are_joined_along_both_edges_of_the_lips() -> None:
    place = np.zeros((len(LANDMARKS.names), 3))  # the mesh tells, not where they are
    lines = marker_lines(LANDMARKS.names, place)
    found = {frozenset(LANDMARKS.names[end] for end in line) for line in lines.tolist()}
    assert found == set().union(*(chain(*row) for row in LANDMARK_ROWS))
    mirror = dict(zip(LANDMARKS.names, np.array(LANDMARKS.names)[LANDMARKS.mirror], strict=True))
    assert {frozenset(map(mirror.__getitem__, line)) for line in found} == found
    for row in LANDMARK_ROWS:
        assert len(set(row)) == len(row)


def test_the_demos_lips_are_two_rows_that_meet_at_the_corners(shot: Shot) -> None:
    take = read_take(shot / "shot.clean.take.usda")
    assert take.markers is not None
    names, at = take.markers.names, take.markers.positions[0]
    found = joined(dict(zip(names, map(tuple, at.tolist()), strict=True)))
    upper = [name for name in names if name.startswith("lip_upper")]
    ends = {name for line in found for name in line}
    assert {*upper, "mouth_corner_L", "mouth_corner_R"} <= ends
    assert not {name for name in ends if name.startswith(("lip_above", "under_eye", "cheek"))}
    corner = [line for line in found if "mouth_corner_L" in line]
    assert {frozenset(line - {"mouth_corner_L"}) for line in corner} == {
        frozenset({"lip_upper_L3"}),
        frozenset({"lip_lower_L3"}),
    }


def test_lines_are_drawn_between_dots() -> None:
    at = np.array([[-40.0, 0, 0], [40, 0, 0], [0, 40, 0]])
    size = {"width": 200, "height": 200}
    bare = draw_markers(at, **size)
    row = draw_markers(at, **size, lines=[[0, 1]])
    changed = np.argwhere((row != bare).any(axis=2))
    assert len(changed) > 50
    assert np.ptp(changed[:, 0]) <= 3, "one thin line"
    middle = int(changed[:, 0].mean())
    assert (row[middle - 6 : middle + 6, 30:36] == bare[middle - 6 : middle + 6, 30:36]).any()


def test_sheet_and_report_join_the_same_markers(shot: Shot) -> None:
    opened = open_shot(shot / "shot.hero.usda", shot / "shot.clean.take.usda")
    equation = set_up_shot_baseline(opened)
    with ShotPictures(opened, height=160, quality="draft") as pictures:
        frame, lines = pictures._framing
        shown = {"cloud": pictures.markers(0), "face": pictures.markers_on_face(0, equation)}
        pictures._placed_lines = np.zeros((0, 2), np.int64)
        pictures._framing = frame, pictures._placed_lines
        assert (pictures.markers(0) != shown["cloud"]).any()
        assert (pictures.markers_on_face(0, equation) != shown["face"]).any()
    execute(
        ReportSpec(
            performance=shot / "shot.hero.usda", out=shot / "x.html", frames="1-9", baseline=False
        )
    )
    text = (shot / "x.html").read_text(encoding="utf-8")
    markers = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])["markers"]
    names = opened.take.markers.names
    there = np.array(markers["lines"]).reshape(-1, 2)
    assert {frozenset(markers["names"][end] for end in line) for line in there.tolist()} == {
        frozenset(names[end] for end in line) for line in lines.tolist()
    }


def test_markers_without_labels_are_joined_by_where_they_lie_on_the_rig(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = open_shot(shot / "shot.hero.usda", shot / "shot.clean.take.usda")
    equation = set_up_shot_baseline(opened)
    assert opened.take.markers is not None
    names = opened.take.markers.names
    silent = [f"M{index}" for index in range(len(names))]
    assert not len(marker_lines(silent, equation.neutral))
    rig = opened.deformer, opened.rig.shapes
    monkeypatch.setattr(deformer, "sample_face_skin", sample_face_skin)  # not coarsely
    by_label, by_place = (
        {frozenset(names[end] for end in line) for line in lines.tolist()}
        for lines in (lines_on_rig(names, equation, *rig), lines_on_rig(silent, equation, *rig))
    )
    rows = ("lip_upper", "lip_lower", "lid_upper", "lid_lower", "mouth_corner")
    told = {line for line in by_label if all(name.startswith(rows) for name in line)}
    assert len(by_place & told) > 0.5 * len(told)
    beside = {name for line in by_place for name in line if not name.startswith(rows)}
    assert len(beside) <= 1  # the next markers above the lip lie 5 mm from its row
    for line in by_place:
        if line & beside:
            continue
        kinds = {next(row for row in rows if name.startswith(row)) for name in line}
        at_corner = all(name.endswith("3") for name in line)  # may be placed beyond the corner
        assert at_corner or len(kinds - {"mouth_corner"}) <= 1, "no line from one row to another"


def test_rows_are_found_whichever_way_the_face_looks() -> None:
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    turned = {name: tuple((turn @ np.array(at)).tolist()) for name, at in FACE.items()}
    assert joined(turned) == joined(FACE)


def test_two_markers_by_themselves_are_no_row() -> None:
    landmarks = {"mouth_R": (-25, 0, 0), "lip_upper": (0, 5, 9), "mouth_L": (25, 0, 0)}
    known = {name: np.array(at, float) for name, at in landmarks.items()}
    places = np.array([(-25.0, 0, 0), (25, 0, 0), (0, 30, 0)])
    assert rows_by_place(places, known) == []
    places[2] = (0, 7, 9)
    (row,) = rows_by_place(places, known)
    assert row.tolist() in ([0, 2, 1], [1, 2, 0])
    assert rows_by_place(places, {}) == []
