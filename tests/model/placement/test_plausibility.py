"""Captures that no face can be are found; faces, whoever's they are, raise no alarm."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.capture.axes import mm_per_unit, rotation_to_y_up
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray, hold_last_seen
from usdface.core.assets import Markers
from usdface.core.errors import InputError
from usdface.demo.acting import performance
from usdface.demo.capture import demo_markers, simulate_capture
from usdface.demo.rig import make_head
from usdface.demo.sculpt import ACTOR
from usdface.model.placement.face_template import face_template, fit_face
from usdface.model.placement.label_hints import label_hint, mirrored_label
from usdface.model.placement.plausibility import check_findings, judge_markers

RATE = 60.0
LABELS = (
    "ForeHead_M ForeHead_L ForeHead_R Leyebrow_M Leyebrow_Inside Leyebrow_Outside Reyebrow_M "
    "Reyebrow_Inside Reyebrow_Outside NoseTop NoseHead NoseHead_L NoseHead_R Leye_Up Leye_Down "
    "Reye_Up Reye_Down Lcheek_Up Rcheek_Up Mouth_Up Mouth_Down Mouth_Lend Mouth_Rend Chin"
).split()
UPS = ("y", "z", "x", "-x", "-y", "-z")

Move = Callable[[Markers], Markers]


def turned(rotation: FloatArray, scale: float = 1.0) -> Move:
    """Return what turns and scales markers."""
    matrix = (scale * rotation).astype(np.float32)
    return lambda markers: replace(markers, positions=markers.positions @ matrix.T)


def synthetic(seed: int = 0, frames: int = 180) -> Markers:
    """Markers beside their places on an adult's face, speaking and turning the head."""
    rng = np.random.default_rng(seed)
    template = face_template(LABELS)
    at = template.places + rng.normal(0, 3.0, template.places.shape)
    clip = np.repeat(at[None], frames, axis=0)
    seconds = np.arange(frames) / RATE
    low = template.places[:, 1] < -70
    clip[:, low, 1] -= 6 + 6 * np.sin(4 * np.pi * seconds)[:, None]
    turns = Rotation.from_rotvec(np.radians(20) * np.outer(np.sin(seconds), [0, 1, 0])).as_matrix()
    clip = np.einsum("fij,fmj->fmi", turns, clip) + rng.normal(0, 0.1, clip.shape) + (0, 1500, 300)
    seen = np.ones(clip.shape[:2], np.bool_)
    return Markers(tuple(LABELS), clip.astype(np.float32), seen, seen.astype(np.float32))


def aspects(markers: Markers, rate: float = RATE) -> dict[str, bool]:
    """Return what is found, and whether it is impossible."""
    return {each.aspect: each.impossible for each in judge_markers(markers, rate)}


def with_sides_exchanged(markers: Markers) -> Markers:
    names = [
        next((each for each in mirrored_label(name) if each in markers.names), name)
        for name in markers.names
    ]
    return replace(markers, names=tuple(names))


def of_columns(markers: Markers, keep: list[int]) -> Markers:
    return Markers(
        tuple(markers.names[i] for i in keep),
        markers.positions[:, keep],
        markers.visible[:, keep],
        markers.confidence[:, keep],
    )


def nameless(markers: Markers) -> Markers:
    return replace(markers, names=tuple(f"F{i:03d}" for i in range(len(markers.names))))


def test_the_template_is_recovered_under_any_similarity() -> None:
    template = face_template(LABELS)
    rotation = Rotation.random(random_state=1).as_matrix()
    moved = 0.7 * template.places @ rotation.T + (10, -20, 5)
    fit = fit_face(template.places, moved, template.weights)
    assert fit.size == pytest.approx(0.7)
    np.testing.assert_allclose(fit.up, rotation[:, 1], atol=1e-12)
    assert fit.explained == pytest.approx(1)
    assert fit.explained_mirrored < 0.9
    mirror = fit_face(template.places, moved * (1, 1, -1), template.weights)
    assert (mirror.explained, mirror.explained_mirrored) == pytest.approx(
        (fit.explained_mirrored, 1)
    )


@pytest.mark.parametrize("scale", [0.62, 0.8, 1.0, 1.2])
@pytest.mark.parametrize("euler", [(0, 0, 0), (0, 170, 0), (30, 40, 0), (-30, 0, 20)])
def test_children_and_adults_who_turn_and_nod_raise_no_alarm(scale, euler) -> None:
    rotation = Rotation.from_euler("xyz", euler, degrees=True).as_matrix()
    markers = turned(rotation, scale)(synthetic())
    assert judge_markers(markers, RATE) == ()
    assert judge_markers(nameless(markers), RATE) == ()


@pytest.mark.parametrize("read_as", ["mm", "cm", "in", "m"])
@pytest.mark.parametrize("unit", ["mm", "cm", "in", "m"])
def test_a_wrong_unit_is_refused_with_the_right_one(unit: str, read_as: str) -> None:
    scale = mm_per_unit(read_as, where="") / mm_per_unit(unit, where="")
    findings = judge_markers(turned(np.eye(3), scale)(synthetic()), RATE)
    if unit == read_as:
        assert findings == ()
        return
    (size,) = findings
    assert size.aspect == "size"
    if {unit, read_as} != {"in", "m"}:  # 39 is nearer to others
        assert f"--units {unit} " in size.remedy
    if (unit, read_as) == ("in", "cm"):  # 0.39 of an adult's: less than a newborn's, no thumb
        assert not size.impossible
        return
    assert size.impossible
    (note,) = check_findings(findings, stated=["size"], where="x")
    assert note == f"{size.message}; if that is not meant, {size.remedy}"
    with pytest.raises(InputError, match=r"a\.csv: the face is .* times the size of an adult's"):
        check_findings(findings, where="a.csv")


@pytest.mark.parametrize("read_as", UPS)
@pytest.mark.parametrize("up", UPS)
def test_a_wrong_up_axis_is_refused_with_the_right_one(up: str, read_as: str) -> None:
    raw = turned(rotation_to_y_up(up=up, where="").T)(synthetic())
    axes = rotation_to_y_up(up=read_as, where="")
    findings = judge_markers(turned(axes)(raw), RATE, axes=axes)
    if up == read_as:
        assert findings == ()
        return
    (tilt,) = findings
    assert (tilt.aspect, tilt.impossible) == ("up", True)
    assert f"--up {up}," in tilt.remedy


def test_exchanged_sides_are_refused_whichever_way() -> None:
    markers = synthetic()
    reflected = turned(np.diag([-1.0, 1, 1]))(markers)
    assert aspects(reflected) == aspects(with_sides_exchanged(markers)) == {"sides": True}
    assert aspects(with_sides_exchanged(reflected)) == {}


@pytest.mark.parametrize(
    ("regions", "side", "words"),
    [
        (set(), "R", "labelled on the right side of the face"),
        ({"mouth", "chin", "jaw"}, None, "labelled on the lower half of the face"),
        ({"forehead", "brow", "bridge", "lid", "eye", "eye corner"}, None, "the upper half"),
        ({"forehead", "brow", "lid", "eye", "eye corner"}, None, "the upper half"),
    ],
)
def test_a_part_without_markers_is_refused_until_it_is_stated(regions, side, words) -> None:
    markers = synthetic()
    hints = [label_hint(label) for label in markers.names]
    keep = [i for i, h in enumerate(hints) if h.region not in regions and h.side != side]
    (finding,) = judge_markers(of_columns(markers, keep), RATE)
    assert finding.aspect == "part"
    assert finding.impossible
    assert words in finding.message
    assert "--partial" in finding.remedy
    assert check_findings([finding], stated=["part"], where="x") == (finding.message,)
    hidden = replace(markers, visible=markers.visible.copy(), confidence=markers.confidence.copy())
    gone = np.setdiff1d(np.arange(len(hints)), keep)
    hidden.visible[:, gone], hidden.confidence[:, gone] = False, 0
    assert aspects(hidden) == {"part": True}, "markers that are never seen are as good as none"


def test_few_labels_do_not_say_where_the_other_markers_lie() -> None:
    markers = synthetic()
    lids = [label_hint(name).region == "lid" for name in markers.names]
    names = (each if lids[i] else f"F{i}" for i, each in enumerate(markers.names))
    (finding,) = judge_markers(replace(markers, names=tuple(names)), RATE)
    assert (finding.aspect, finding.impossible) == ("part", False)
    assert f"unless {len(lids) - sum(lids)} without such a label cover it" in finding.message


@pytest.mark.parametrize(
    ("labels", "at"),
    [
        ("a b c", [[0, 0, 0], [50, 0, 0], [100, 0, 0]]),
        ("a b c", np.zeros((3, 3))),
        (" ".join(f"mouth{i}" for i in range(9)), np.random.default_rng(0).normal(0, 20, (9, 3))),
    ],
    ids=["on a line", "at one point", "with one place on the template"],
)
def test_markers_that_determine_no_pose_are_judged_without_one(labels: str, at) -> None:
    """Neither warnings of numpy nor values that are not finite."""
    positions = np.repeat(np.array(at, np.float32)[None], 60, axis=0)
    seen = np.ones(positions.shape[:2], np.bool_)
    names = tuple(labels.split())
    found = judge_markers(Markers(names, positions, seen, seen.astype(np.float32)), RATE)
    assert not any("nan" in each.message or "inf" in each.message for each in found)


def test_outliers_are_not_speed() -> None:
    markers = synthetic()
    rng = np.random.default_rng(1)
    positions = markers.positions.copy()
    spikes = rng.random(positions.shape[:2]) < 0.015
    positions[spikes] += rng.normal(0, 15, (spikes.sum(), 3)).astype(np.float32)
    assert "rate" not in aspects(replace(markers, positions=positions))


def test_speed_is_judged_over_the_skull_and_by_the_rate() -> None:
    markers = synthetic()
    assert aspects(markers, RATE * 12)["rate"]
    running = replace(
        markers,
        positions=markers.positions
        + (5000 / RATE * np.arange(180)[:, None, None] * [1, 0, 0]).astype(np.float32),
    )
    assert aspects(running) == {}, "an actor who runs at 5 m/s keeps his skin"
    assert aspects(markers, 6.0) == {"rate": False}


CAPTURES = (
    "markers_animface/CheeksMoCap.c3d",
    "markers_animface/EyebrowsMoCap.c3d",
    "crosstake/take.c3d",
    "onesided/take.c3d",
    "demo",
)


def capture(shared_data: Path, name: str) -> tuple[Markers, float]:
    if name != "demo":
        take = read_capture(shared_data / name).take
        assert take.markers is not None
        return take.markers, float(take.rate)
    actor, acted = make_head(ACTOR), performance()
    placed = demo_markers(actor)
    positions, seen = simulate_capture(actor, acted, placed)
    return (
        Markers(placed.names, positions, seen, seen.astype(np.float32)),
        float(acted.weights.rate),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", CAPTURES)
def test_recorded_takes_pass_and_what_is_done_to_them_is_found(shared_data, name: str) -> None:
    markers, rate = capture(shared_data, name)
    z_up = rotation_to_y_up(up="z", where="")
    for take in (markers, nameless(markers)):
        assert judge_markers(take, rate) == ()
        assert aspects(turned(np.eye(3), 0.1)(take), rate) == {"size": True}
        assert aspects(turned(np.eye(3), 25.4)(take), rate) == {"size": True}
        assert "up" in aspects(turned(z_up)(take), rate)
        assert "up" in aspects(turned(z_up.T)(take), rate)
        assert "rate" in aspects(take, rate * 10)
    if with_sides_exchanged(markers).names != markers.names:
        assert aspects(with_sides_exchanged(markers), rate) == {"sides": True}
        assert aspects(turned(np.diag([-1.0, 1, 1]))(markers), rate) == {"sides": True}
        assert aspects(turned(z_up)(markers), rate) == {"up": True}


def test_bodies_are_not_taken_for_faces(shared_data: Path) -> None:
    judged = 0
    for path in sorted((shared_data / "c3d").rglob("*")):
        if path.suffix.lower() not in (".c3d", ".trc") or path.name == "MACsample.c3d":
            continue  # whose labels are there twice
        take = read_capture(path).take
        assert aspects(take.markers, float(take.rate)).items() <= {"part": False}.items(), path.name
        judged += 1
    assert judged >= 6


def test_two_people_in_one_file_are_not_one_head() -> None:
    ours, theirs = nameless(synthetic()), synthetic(seed=1)
    turn = Rotation.from_rotvec(np.outer(np.linspace(0, 1, len(theirs.positions)), [0, 1, 0]))
    moved = np.einsum("fij,fmj->fmi", turn.as_matrix(), theirs.positions)
    both = Markers(
        ours.names + tuple(f"G{i:03d}" for i in range(len(theirs.names))),
        np.concatenate([ours.positions, np.add(moved, [900, 0, 0]).astype(np.float32)], axis=1),
        np.concatenate([ours.visible, theirs.visible], axis=1),
        np.concatenate([ours.confidence, theirs.confidence], axis=1),
    )
    (finding,) = judge_markers(both, RATE)
    assert not finding.impossible
    assert "several people" in finding.remedy


@pytest.mark.parametrize("last_seen", [180, 60])
def test_a_head_that_walks_away_from_hidden_markers_is_one_head(last_seen: int) -> None:
    markers = synthetic()
    walked = np.linspace(0, 500, len(markers.positions), dtype=np.float32)
    positions = markers.positions + walked[:, None, None]
    visible = markers.visible.copy()
    visible[last_seen:, ::3] = False
    hold_last_seen(positions, visible)
    confidence = visible.astype(np.float32)
    names = tuple(f"m{i}" for i in range(len(LABELS)))
    assert aspects(Markers(names, 20 * positions, visible, confidence)) == {"size": True}
