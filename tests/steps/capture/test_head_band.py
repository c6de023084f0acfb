"""Rigid markers that are not named: on a head band by their labels, or none at all."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.core.assets import Markers, Take
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

BAND = ("head_1", "head_2", "head_3", "head_4")
SKIN = tuple(
    f"{part}_{side}{n}" for part in ("brow", "cheek", "mouth") for side in "LR" for n in "12"
)
FRAMES, NOISE_MM = 300, 0.15


def write_turning(path: Path, *, band_motion_mm: float, band_names: tuple[str, ...] = BAND) -> None:
    """Write a head that turns, with a band and a mouth that move, brows and cheeks that do not."""
    rng = np.random.default_rng(0)
    band = np.array([[-60, 75, -60], [60, 75, -60], [0, 95, -40], [-75, 40, -100]], float)
    skin = np.stack([rng.uniform(-50, 50, 12), np.repeat([30, 0, -40], 4), np.full(12, 40.0)], 1)
    t = np.arange(FRAMES)[:, None, None] / 60
    still = np.concatenate([band, skin])
    face = np.repeat(still[None], FRAMES, axis=0)
    face[:, -4:, 1:2] += 8 * np.sin(5 * t)
    face[:, :4] += band_motion_mm * np.sin(t * rng.uniform(2, 6, (4, 3)))
    turns = Rotation.from_rotvec(np.sin(2 * t[:, 0]) * [0.1, 0.3, 0.05]).as_matrix()
    moved = np.einsum("fij,fkj->fki", turns, face) + rng.normal(0, NOISE_MM, face.shape)
    seen = np.ones(moved.shape[:2], bool)
    markers = Markers(
        names=(*band_names, *SKIN),
        positions=moved.astype(np.float32),
        visible=seen,
        confidence=seen.astype(np.float32),
        neutral_frame=1,
    )
    write_take(
        path,
        Take(name="band", rate=Fraction(60), first_frame=1, markers=markers),
        provenance=Provenance(),
    )


@pytest.mark.parametrize("band_motion_mm", [0.0, 1.5], ids=["band", "loose"])
def test_a_band_is_rigid_where_it_proves_so(tmp_path: Path, band_motion_mm: float) -> None:
    take, out, named = (tmp_path / f"{name}.take.usda" for name in ("band", "clean", "named"))
    write_turning(take, band_motion_mm=band_motion_mm)
    notes = [note for note in execute(CleanSpec(take=take, out=out)).notes if "rigid" in note]
    cleaned = read_take(out).markers
    assert cleaned is not None
    if band_motion_mm:
        assert any("estimated from all markers" in note for note in notes)
        return
    assert cleaned.rigid == BAND, "brows and cheeks are as still, and are skin"
    (note,) = notes
    assert "head_1, head_2, head_3, head_4, of a head band by their labels, are used" in note
    execute(CleanSpec(take=take, out=named, rigid=BAND))
    same = read_take(named).markers
    assert same is not None
    np.testing.assert_array_equal(cleaned.positions, same.positions)


def test_labels_of_no_part_of_the_face_are_of_the_head_where_they_prove_so(tmp_path: Path) -> None:
    take, out = tmp_path / "band.take.usda", tmp_path / "clean.take.usda"
    names = ("HB_L", "HB_R", "HB_T", "X4")
    write_turning(take, band_motion_mm=0.0, band_names=names)
    notes = execute(CleanSpec(take=take, out=out)).notes
    assert any("HB_L, HB_R, HB_T, X4, of no part of a face by" in note for note in notes)
    cleaned = read_take(out).markers
    assert cleaned is not None
    assert cleaned.rigid == names


def test_a_head_without_rigid_markers_is_followed_by_the_most_rigid(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rest = np.stack([rng.uniform(-60, 60, 30), rng.uniform(-70, 60, 30), np.full(30, 40.0)], axis=1)
    rest[:, 2] -= 0.01 * (rest[:, 0] ** 2 + rest[:, 1] ** 2)
    t = np.arange(FRAMES)[:, None, None] / 60
    motion_mm = np.where(rest[:, 1:2] < -20, 6.0, 1.5)
    face = rest + motion_mm * np.sin(t * rng.uniform(2, 9, (30, 3)) + rng.uniform(0, 6, (30, 3)))
    turns = Rotation.from_rotvec(np.sin(2 * t[:, 0]) * [0.1, 0.3, 0.05])
    moved = np.einsum("fij,fkj->fki", turns.as_matrix(), face)
    seen = np.ones(moved.shape[:2], bool)
    names = tuple(f"m{number}" for number in range(30))
    markers = Markers(names, moved.astype(np.float32), seen, seen.astype(np.float32), (), 1)
    take, out = tmp_path / "skin.take.usda", tmp_path / "clean.take.usda"
    captured = Take(name="skin", rate=Fraction(60), first_frame=1, markers=markers)
    write_take(take, captured, provenance=Provenance())
    notes = execute(CleanSpec(take=take, out=out)).notes
    assert any("degrees of error in the head's rotation" in note for note in notes)
    cleaned = read_take(out)
    assert cleaned.markers is not None
    assert cleaned.head_motion is not None
    assert (motion_mm[[names.index(name) for name in cleaned.markers.rigid]] < 6).all()
    found = Rotation.from_matrix(cleaned.head_motion[:, :3, :3]) * turns[0] * turns.inv()
    assert np.rad2deg(found.magnitude()).mean() < 2.5


def test_parts_in_labels_tell_a_jaw_from_the_head(tmp_path: Path) -> None:
    """The lower face moves as one body, more rigid than the skin of the skull."""
    rng = np.random.default_rng(2)
    heights = np.repeat([50, 20, 0, -40, -60], 6)
    rest = np.stack([np.tile([-55, -35, -15, 15, 35, 55], 5), heights, np.zeros(30)], 1) * 1.0
    rest[:, 2] = 50 - 0.01 * (rest[:, 0] ** 2 + rest[:, 1] ** 2)
    names = tuple(
        f"{part}_{'RL'[number > 2]}{number}"
        for part in ("brow", "nose", "cheek", "jaw", "chin")
        for number in range(6)
    )
    t = np.arange(FRAMES)[:, None, None] / 60
    face = rest + 0.6 * np.sin(t * rng.uniform(2, 9, (30, 3)) + rng.uniform(0, 6, (30, 3)))
    face[:, 18:] = rest[18:] + [0, -6, 0] * (1 - np.cos(3 * t))
    turns = Rotation.from_rotvec(np.sin(2 * t[:, 0]) * [0.1, 0.3, 0.05])
    moved = np.einsum("fij,fkj->fki", turns.as_matrix(), face)
    moved += rng.normal(0, NOISE_MM, moved.shape)
    seen = np.ones(moved.shape[:2], bool)
    markers = Markers(names, moved.astype(np.float32), seen, seen.astype(np.float32), (), 1)
    take, out = tmp_path / "jaw.take.usda", tmp_path / "clean.take.usda"
    captured = Take(name="jaw", rate=Fraction(60), first_frame=1, markers=markers)
    write_take(take, captured, provenance=Provenance())
    execute(CleanSpec(take=take, out=out))
    cleaned = read_take(out)
    assert cleaned.markers is not None
    assert cleaned.head_motion is not None
    assert not [name for name in cleaned.markers.rigid if name.startswith(("jaw", "chin"))]
    found = Rotation.from_matrix(cleaned.head_motion[:, :3, :3]) * turns[0] * turns.inv()
    assert np.rad2deg(found.magnitude()).mean() < 0.7
