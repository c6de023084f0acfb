"""Shapes matched by what they do: on faces of other proportions, topology and names."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import coarse_rig
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.demo.sculpt import ACTOR
from usdface.model.retarget.face_correspondence import Correspondence, correspond, match_positions
from usdface.model.retarget.shape_matching import differing_sides, match_deformations
from usdface.usdio.rig.read import read_rig


@pytest.fixture(scope="module")
def faces():
    return coarse_rig(), coarse_rig(ACTOR)


def test_another_face_with_the_same_shapes_is_matched(faces) -> None:
    hero, actor = faces
    matches = match_deformations(actor, hero, source_shapes=actor.shapes, target_shapes=hero.shapes)
    right = [match for match in matches if match.source == match.target]
    assert len(matches) >= 45
    assert len(right) >= 0.9 * len(matches)
    assert all(0.5 <= match.similarity <= 1.0 + 1e-9 for match in matches)
    assert len({match.target for match in matches}) == len(matches)


def test_matching_positions_recovers_a_pose_of_the_same_face(faces) -> None:
    hero, _ = faces
    both = correspond(hero, hero)
    weights = np.zeros((2, len(hero.shapes)))
    weights[0, hero.shapes.index("jawOpen")] = 0.8
    weights[1, hero.shapes.index("mouthSmileLeft")] = 1.0
    found = match_positions(both, weights)
    assert (found >= 0).all()
    assert found[0].argmax() == hero.shapes.index("jawOpen")
    assert found[1].argmax() == hero.shapes.index("mouthSmileLeft")
    np.testing.assert_allclose(found[weights > 0], weights[weights > 0], atol=0.15)


def with_ends(rig: Rig, ends: dict[str, float]) -> Rig:
    """Return a rig that looks the same, with shapes that are full at other weights."""
    meshes = tuple(
        replace(
            mesh,
            shapes=tuple(
                MeshShape(
                    each.name,
                    tuple(
                        ShapeKey(key.weight, key.points, key.offsets / ends.get(each.name, 1.0))
                        for key in each.keys
                    ),
                )
                for each in mesh.shapes
            ),
        )
        for mesh in rig.meshes
    )
    full = np.array([ends.get(name, 1.0) for name in rig.shapes])
    return replace(rig, meshes=meshes, ranges=np.sort(np.outer(full, [0, 1]), axis=1))


def test_positions_are_matched_by_weights_in_the_ranges_of_both_rigs(faces) -> None:
    hero, _ = faces
    other = with_ends(hero, {"jawOpen": -1.0, "mouthSmileLeft": 2.0})
    used = [hero.shapes.index(name) for name in ("jawOpen", "mouthSmileLeft")]
    weights = np.zeros((1, len(hero.shapes)))
    weights[0, used] = 0.8, 1.0
    found = match_positions(correspond(hero, hero), weights)
    there = match_positions(correspond(hero, other), weights)
    np.testing.assert_allclose(there[0, used], found[0, used] * [-1, 2], atol=1e-6)
    back = weights.copy()
    back[0, used] *= [-1, 2]
    np.testing.assert_allclose(match_positions(correspond(other, hero), back), found, atol=1e-6)


def test_nothing_to_match_is_no_match(faces) -> None:
    assert match_deformations(*faces, source_shapes=(), target_shapes=("jawOpen",)) == ()


def test_heads_of_two_makers_are_matched(shared_data: Path) -> None:
    ict = read_rig(shared_data / "rigs" / "ict_face.usdc")
    cap = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    matches = match_deformations(ict, cap, source_shapes=ict.shapes, target_shapes=cap.shapes)
    right = [m for m in matches if m.target == m.source or m.source[:-2] == m.target]
    assert len(matches) >= 45
    assert len(right) >= 0.88 * len(matches)  # those that are not: two ways to say the same
    # The other way round it is the same two faces at the same places.
    again = match_deformations(cap, ict, source_shapes=cap.shapes, target_shapes=ict.shapes)
    right = [m for m in again if m.target == m.source or m.target[:-2] == m.source]
    assert len({m.source for m in right}) >= 42


def foreign(rig: Rig, names: dict[str, str] | None = None) -> Rig:
    """Return a rig with names that say only which shapes mirror each other: ``Form_3_L``."""
    motions = dict.fromkeys(re.sub("Left$|Right$", "", name) for name in rig.shapes)
    number = {motion: index for index, motion in enumerate(motions)}
    called = {}
    for name in rig.shapes:
        motion = re.sub("Left$|Right$", "", name)
        side = name.removeprefix(motion)[:1]
        called[name] = f"Form_{number[motion]}_{side}".removesuffix("_")
    called |= names or {}
    meshes = tuple(
        replace(mesh, shapes=tuple(replace(each, name=called[each.name]) for each in mesh.shapes))
        for mesh in rig.meshes
    )
    return replace(rig, shapes=tuple(called.values()), meshes=meshes)


def test_sides_of_foreign_names_are_matched_alike(faces) -> None:
    hero, actor = map(foreign, faces)
    matches = match_deformations(actor, hero, source_shapes=actor.shapes, target_shapes=hero.shapes)
    right = [match for match in matches if match.source == match.target]
    assert len(right) >= 0.9 * len(matches) >= 35
    driven = {match.source: [match.target] for match in matches}
    assert differing_sides(driven, actor.shapes, hero.shapes) == []


def doll(rig: Rig) -> Rig:
    """Return a rig with the proportions of a doll: a high skull, a short jaw and a flat face."""
    cheek_y = -25.0  # [mm]

    def stretched(mesh: RigMesh) -> RigMesh:
        scale = np.tile([1.2, 1.0, 0.7], (len(mesh.points), 1))
        scale[:, 1] = np.where(mesh.points[:, 1] > cheek_y, 1.7, 0.55)
        shapes = tuple(
            replace(
                each,
                keys=tuple(replace(k, offsets=k.offsets * scale[k.points]) for k in each.keys),
            )
            for each in mesh.shapes
        )
        points = (mesh.points - [0, cheek_y, 0]) * scale
        return replace(mesh, points=points, shapes=shapes)

    return replace(rig, meshes=tuple(map(stretched, rig.meshes)))


@pytest.mark.parametrize("turn", [1, -1])
def test_a_stylised_face_is_aligned_by_its_eyes_and_mouth(faces, turn: int) -> None:
    source, target = (foreign(rig) for rig in (doll(faces[0]), faces[1])[::turn])
    matches = match_deformations(
        source, target, source_shapes=source.shapes, target_shapes=target.shapes
    )
    right = [match for match in matches if match.source == match.target]
    assert len(right) >= 0.9 * len(matches) >= 35


def test_lids_are_matched_with_no_mouth_wherever_a_face_is_aligned(faces, monkeypatch) -> None:
    hero, actor = map(foreign, faces)
    called = dict(zip(faces[0].shapes, hero.shapes, strict=True))
    blink, smile = called["eyeBlinkLeft"], called["mouthSmileLeft"]
    monkeypatch.setattr(Correspondence, "similarity", lambda both: np.ones((len(both.source),) * 2))
    assert match_deformations(actor, hero, source_shapes=(blink,), target_shapes=(smile,)) == ()
    assert match_deformations(actor, hero, source_shapes=(blink,), target_shapes=(blink,))


def test_a_look_down_is_no_blink(faces) -> None:
    hero, actor = map(foreign, faces)
    called = dict(zip(faces[0].shapes, hero.shapes, strict=True))
    looks, blinks = (
        tuple(called[f"{name}{side}"] for side in ("Left", "Right"))
        for name in ("eyeLookDown", "eyeBlink")
    )
    assert match_deformations(actor, hero, source_shapes=looks, target_shapes=blinks) == ()
    both = match_deformations(actor, hero, source_shapes=looks, target_shapes=blinks + looks)
    assert {match.source: match.target for match in both} == dict(zip(looks, looks, strict=True))


def test_halves_drive_a_whole_alike_and_a_whole_its_halves(faces) -> None:
    hero, actor = foreign(faces[0]), foreign(faces[1])
    place = dict(zip(faces[0].shapes, hero.shapes, strict=True))
    smiles = place["mouthSmileLeft"], place["mouthSmileRight"]
    whole = "Grinsen"

    def grin(mesh: RigMesh) -> RigMesh:
        keys = [each.keys[-1] for each in mesh.shapes if each.name in smiles]
        if not keys:
            return mesh
        moved = np.zeros_like(mesh.points)
        for key in keys:
            moved[key.points] += key.offsets
        points = np.flatnonzero(moved.any(axis=1))
        made = MeshShape(whole, (ShapeKey(1.0, points, moved[points]),))
        rest = [each for each in mesh.shapes if each.name not in smiles]
        return replace(mesh, shapes=(*rest, made))

    names = (*(name for name in hero.shapes if name not in smiles), whole)
    ranges = np.tile([0.0, 1.0], (len(names), 1))
    other = replace(hero, shapes=names, meshes=tuple(map(grin, hero.meshes)), ranges=ranges)
    forth = match_deformations(actor, other, source_shapes=smiles, target_shapes=(whole,))
    assert {(each.source, each.target, each.share) for each in forth} == {
        (smile, whole, 0.5) for smile in smiles
    }
    back = match_deformations(other, actor, source_shapes=(whole,), target_shapes=smiles)
    assert {(each.target, each.share) for each in back} == {(smile, 1.0) for smile in smiles}


def test_a_side_that_the_other_rig_lacks_is_matched_and_named(faces) -> None:
    hero, actor = map(foreign, faces)
    called = dict(zip(faces[0].shapes, hero.shapes, strict=True))
    left, right = called["mouthSmileLeft"], called["mouthSmileRight"]
    found = match_deformations(actor, hero, source_shapes=(left, right), target_shapes=(right,))
    assert [(match.source, match.target) for match in found] == [(right, right)]
    driven = {match.source: [match.target] for match in found}
    said = differing_sides(driven, actor.shapes, hero.shapes)
    assert said == [f"{left} -> nothing; {right} -> {right}"]
    crossed = {left: [right], right: [left]}
    assert differing_sides(crossed, actor.shapes, hero.shapes) == []
    whole = called["browInnerUp"]
    assert differing_sides({whole: [left]}, actor.shapes, hero.shapes) == [f"{whole} -> {left}"]


@pytest.mark.parametrize("turn", [1, -1])
def test_numbered_shapes_keep_their_side(faces, turn: int) -> None:
    hero, actor = faces
    chosen = ("mouthSmileLeft", "mouthSmileRight", "eyeBlinkLeft", "eyeBlinkRight", "jawOpen")
    numbers = {name: f"shape_{index:03d}" for index, name in enumerate(hero.shapes)}
    named, numbered = (actor, hero)[::turn]
    numbered = foreign(numbered, numbers)
    sides = chosen, tuple(numbers[name] for name in chosen)
    (source, target), (names, other_names) = (named, numbered)[::turn], sides[::turn]
    matches = match_deformations(source, target, source_shapes=names, target_shapes=other_names)
    assert {each.source: each.target for each in matches} == dict(
        zip(names, other_names, strict=True)
    )
    assert all(each.share == 1.0 for each in matches)
    driven = {each.source: [each.target] for each in matches}
    assert differing_sides(driven, source.shapes, target.shapes) == []


def test_both_sides_drive_a_whole_whatever_their_names(shared_data: Path) -> None:
    heads = [read_rig(shared_data / "rigs" / f"{n}.usdc") for n in ("ict_face", "facecap_head")]
    numbers = [{n: f"form_{i}" for i, n in enumerate(sorted(rig.shapes))} for rig in heads]
    numbered = [foreign(*each) for each in zip(heads, numbers, strict=True)]
    for turn in (1, -1):
        (source, target), (ours, theirs) = numbered[::turn], numbers[::turn]
        matches = match_deformations(
            source, target, source_shapes=source.shapes, target_shapes=target.shapes
        )
        driven = {(each.source, each.target): each.share for each in matches}
        for whole in ("cheekPuff", "browInnerUp"):
            for side in ("_L", "_R"):
                names = (whole + side, whole)[::turn]
                share = driven.pop((ours[names[0]], theirs[names[1]]))
                assert share == (0.5 if turn == 1 else 1.0)
        assert set(driven.values()) == {1.0}


def test_the_same_head_is_not_moved_whatever_its_shapes_tell(faces, monkeypatch) -> None:
    hero = faces[0]
    numbered = foreign(hero, {name: f"s{index}" for index, name in enumerate(hero.shapes)})
    landmarks = iter(({"lid_upper_L": np.zeros(3)}, {"mouth_middle": np.zeros(3)}))
    monkeypatch.setattr(
        "usdface.model.retarget.face_correspondence.find_landmarks", lambda *_: next(landmarks)
    )
    both = correspond(hero, numbered)
    np.testing.assert_allclose(both.source, both.target, atol=1e-3)  # [mm]


def test_one_equal_pair_outweighs_two_half_similar_ones(faces, monkeypatch) -> None:
    hero, actor = map(foreign, faces)
    chosen = tuple(
        dict(zip(faces[0].shapes, hero.shapes, strict=True))[name]
        for name in ("mouthPucker", "mouthFunnel")
    )
    rows = [hero.shapes.index(name) for name in chosen]
    made = np.zeros((len(hero.shapes),) * 2)
    made[np.ix_(rows, rows)] = [[1.0, 0.6], [0.6, 0.0]]
    monkeypatch.setattr(Correspondence, "similarity", lambda _: made)
    found = match_deformations(actor, hero, source_shapes=chosen, target_shapes=chosen)
    assert [(each.source, each.target) for each in found] == [(chosen[0], chosen[0])]


@pytest.mark.parametrize("similarity", [0.4, 0.6])
def test_a_side_is_as_easily_matched_with_a_number_as_any_shape(
    faces, monkeypatch, similarity: float
) -> None:
    hero = faces[0]
    chosen = ("mouthSmileLeft", "mouthSmileRight")
    numbers = {name: f"shape_{index:03d}" for index, name in enumerate(hero.shapes)}
    numbered, targets = foreign(hero, numbers), tuple(numbers[name] for name in chosen)
    rows = [hero.shapes.index(name) for name in chosen]
    made = np.zeros((len(hero.shapes),) * 2)
    made[rows, rows] = similarity
    monkeypatch.setattr(Correspondence, "similarity", lambda _: made)
    found = match_deformations(hero, numbered, source_shapes=chosen, target_shapes=targets)
    expected = list(zip(chosen, targets, strict=True)) if similarity > 0.5 else []
    assert [(each.source, each.target) for each in found] == expected
