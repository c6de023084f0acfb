"""What the train step gives to training beyond the pairs."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, ShapeKey
from usdface.core.deformer import Deformer
from usdface.core.rig_logic import Combination, logic_of
from usdface.core.sidecars import proposed_path
from usdface.media.picture.image import read_picture
from usdface.model.mapping import candidates
from usdface.model.regressions.driven_motion import driven_weights
from usdface.numerics.measure.face_regions import gaze_and_tongue_shapes, mirrored_shapes
from usdface.runner.execute import execute
from usdface.specs.performance import TrainSpec
from usdface.specs.references import ReferencesImportSpec
from usdface.steps.performance import train
from usdface.steps.performance.describe import describe_mapping
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import read_proposals
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

pytestmark = pytest.mark.usefixtures("without_comparison")


def test_the_geometry_of_the_rig_takes_part_in_training(
    finished_shot: Shot, tmp_path: Path
) -> None:
    references, out = finished_shot / "hero.references.usda", tmp_path / "x.mapping.usdc"
    execute(TrainSpec(references=references, out=out, method="face_map"))
    arrays = read_mapping(out).arrays
    never_keyed = arrays["forward_targets"].max(axis=0) == 0
    assert never_keyed.any()
    assert arrays["forward_shape_size2"][never_keyed].max() > 1


def test_the_share_of_variance_is_that_of_the_take_and_the_eigen_space_is_drawn(
    finished_shot: Shot, tmp_path: Path
) -> None:
    references, out = finished_shot / "hero.references.usda", tmp_path / "x.mapping.usdc"
    picture = tmp_path / "x.jpg"
    made = execute(TrainSpec(references=references, out=out, method="ridge", picture=picture))
    markers = read_take(finished_shot / "shot.clean.take.usda").markers
    packed = markers.positions.reshape(len(markers.positions), -1).astype(float)
    values = np.linalg.svd(packed - packed.mean(axis=0), compute_uv=False) ** 2
    shares = np.array(made.figures["variance_shares"])
    np.testing.assert_allclose(shares[:8], (values / values.sum())[:8], atol=1e-5)
    line = f"4 principal components hold {100 * shares[:4].sum():.2f} %"
    assert any(note.startswith(line) for note in made.notes)
    assert describe_mapping(out).table[0].startswith(line)
    assert read_picture(picture).std() > 10


def test_keys_of_the_largest_shapes_alone_are_told(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, out = finished_shot / "hero.references.usda", tmp_path / "x.mapping.usdc"
    pairs = read_references(given)
    third = np.sort(pairs.weights, axis=1)[:, [-3]]
    for weights, told in ((np.where(pairs.weights < third, 0, pairs.weights), True), (None, False)):
        changed = pairs if weights is None else replace(pairs, weights=weights)
        monkeypatch.setattr(
            "usdface.steps.performance.train.read_keyed_references", lambda path, got=changed: got
        )
        notes = execute(TrainSpec(references=given, out=out, method="face_map")).notes
        assert any("as if only the largest were keyed" in note for note in notes) is told


def test_weights_beyond_the_range_and_pairs_that_repeat_are_told(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, out = finished_shot / "hero.references.usda", tmp_path / "x.mapping.usdc"
    pairs = read_references(given)
    again = np.r_[np.arange(len(pairs.frames)), 3]
    weights = pairs.weights.copy()
    weights[0, pairs.shape_names.index("jawOpen")] = 1.4
    changed = replace(pairs, weights=weights).rows(again)
    monkeypatch.setattr(
        "usdface.steps.performance.train.read_keyed_references", lambda path: changed
    )
    notes = execute(TrainSpec(references=given, out=out, method="ridge")).notes
    assert any(
        note.startswith("1 weight of the pairs outside the range of jawOpen") for note in notes
    )
    assert any(note.startswith("left out 1 pair with the markers") for note in notes)


@pytest.mark.parametrize(
    ("mirrored", "said"), [(0, None), (1, "exchanged in 1 pair, "), (6, "exchanged in ")]
)
def test_mirrored_keys_are_noticed(
    finished_shot: Shot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    mirrored: int,
    said: str | None,
) -> None:
    given = finished_shot / "hero.references.usda"
    pairs = read_references(given)
    other = mirrored_shapes(pairs.shape_names)
    proposed = read_proposals(proposed_path(given), pairs)
    leaning = np.argsort(-np.linalg.norm(proposed - proposed[:, other], axis=1))
    weights = proposed.copy()
    weights[leaning[:mirrored]] = proposed[leaning[:mirrored]][:, other]
    # A nearly symmetric expression may lean the other way by the errors of its keys.
    row = leaning[mirrored]
    lean = proposed[row] - proposed[row, other]
    weights[row] = proposed[row] - lean / 2 - 0.1 * lean / np.linalg.norm(lean)
    weights[row, pairs.shape_names.index("jawOpen")] = 1.0
    keyed = replace(pairs, weights=weights, tuned=np.ones(len(weights), bool))
    monkeypatch.setattr(train, "read_keyed_references", lambda path: keyed)
    _, notes = train._read_pairs(TrainSpec(references=given, out=tmp_path / "x.usdc"))
    found = [note for note in notes if "left and right may be exchanged" in note]
    assert len(found) == (said is not None)
    assert all(said in note for note in found)


def test_shapes_that_markers_do_not_show_are_named_and_no_error_of_the_skin(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = finished_shot / "hero.references.usda"
    pairs = read_references(given)
    weights, unseen = pairs.weights.copy(), gaze_and_tongue_shapes(pairs.shape_names)
    weights[:, unseen] = 0.0
    for keyed in (0.0, 0.8):
        weights[2, pairs.shape_names.index("tongueOut")] = keyed
        changed = replace(pairs, weights=weights)
        monkeypatch.setattr(
            "usdface.steps.performance.train.read_keyed_references", lambda path, got=changed: got
        )
        out = tmp_path / f"{keyed}.mapping.usdc"
        made = execute(TrainSpec(references=given, out=out, method="ridge"))
        noted = any("do not show gaze and tongue: tongueOut is" in note for note in made.notes)
        assert noted == (keyed > 0)
        counted = read_mapping(out).arrays["uncertainty_grams"].any(axis=(0, 2))
        assert not counted[unseen].any()
        assert np.delete(counted, unseen).any()


def test_shapes_that_no_pair_has_are_named_if_markers_can_show_them(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = finished_shot / "hero.references.usda"
    pairs = read_references(given)
    weights = np.full_like(pairs.weights, 0.2)
    weights[::2] = 0.1
    unkeyed = ["mouthPucker", "tongueOut", "eyeLookUpLeft", "jawOpen"]
    weights[:, [pairs.shape_names.index(name) for name in unkeyed]] = 0.0
    for each, names in ((weights, ["jawOpen", "mouthPucker"]), (weights + 0.1, [])):
        changed = replace(pairs, weights=each)
        monkeypatch.setattr(
            "usdface.steps.performance.train.read_keyed_references", lambda path, got=changed: got
        )
        out = tmp_path / f"{len(names)}.mapping.usdc"
        made = execute(TrainSpec(references=given, out=out, method="ridge"))
        assert made.figures["unkeyed_shapes"] == names
        found = [note for note in made.notes if note.startswith("0 in every pair: ")]
        assert len(found) == bool(names)
        assert not names or "pair: 2 shapes, jawOpen, mouthPucker. They" in found[0]


def test_a_rig_with_foreign_names_has_the_regions_and_the_gaze_of_the_same_rig_with_known_ones(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(candidates, "MINIMUM_TO_COMPARE", 8)  # as calibrations are compared
    given = finished_shot / "hero.references.usda"
    pairs, rig = read_references(given), read_rig(finished_shot / "hero.usdc")
    made = execute(TrainSpec(references=given, out=tmp_path / "known.usdc", method="ridge"))
    named = read_mapping(tmp_path / "known.usdc")
    called = {name: f"Form_{index}" for index, name in enumerate(rig.shapes)}
    meshes = tuple(
        replace(mesh, shapes=tuple(replace(each, name=called[each.name]) for each in mesh.shapes))
        for mesh in rig.meshes
    )
    step = "usdface.steps.performance.train"
    foreign = replace(rig, shapes=tuple(called.values()), meshes=meshes)
    changed = replace(pairs, shape_names=tuple(called[name] for name in pairs.shape_names))
    monkeypatch.setattr(f"{step}.read_rig_of", lambda *given: foreign)
    monkeypatch.setattr(f"{step}.read_keyed_references", lambda path: changed)
    other = execute(TrainSpec(references=given, out=tmp_path / "foreign.usdc", method="ridge"))
    mapping = read_mapping(tmp_path / "foreign.usdc")
    assert mapping.settings["regions"] == named.settings["regions"]
    for name in ("region_markers", "uncertainty_grams", "uncertainty_calibration"):
        np.testing.assert_array_equal(mapping.arrays[name], named.arrays[name])
    gaze, other_gaze = (
        [note for note in each.notes if "do not show gaze" in note] for each in (made, other)
    )
    assert len(gaze) == len(other_gaze) == 1
    assert called["eyeLookDownLeft"] in other_gaze[0]
    unkeyed = [called[name] for name in made.figures["unkeyed_shapes"]]
    assert sorted(other.figures["unkeyed_shapes"]) == sorted(unkeyed)


def test_parts_of_the_face_that_no_shape_moves_are_noted(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = finished_shot / "hero.references.usda"
    step = "usdface.steps.performance.train"
    for unknown in (False, True):
        out = tmp_path / f"{unknown}.mapping.usdc"
        if unknown:
            monkeypatch.setattr(f"{step}.shape_parts", lambda rig, deformer: ("",) * 52)
        notes = execute(TrainSpec(references=given, out=out, method="ridge")).notes
        assert unknown == any("is known to move the brows, lids" in note for note in notes)
    assert read_mapping(out).settings["regions"] == "face"


def test_authors_whose_keys_differ_in_gain_are_named(finished_shot: Shot, tmp_path: Path) -> None:
    folder = tmp_path / "shot"
    shutil.copytree(finished_shot.folder, folder)
    references, out = folder / "hero.references.usda", tmp_path / "x.mapping.usdc"
    exact = execute(TrainSpec(references=references, out=out, method="face_map"))
    assert not any("differ in gain" in note for note in exact.notes)
    pairs = read_references(references)
    for row, (author, gain) in enumerate((("anna", 1.15), ("ben", 0.85))):
        table = [",".join(("frame", *pairs.shape_names))]
        for frame, weights in zip(pairs.frames[row::2], pairs.weights[row::2], strict=True):
            table.append(",".join(map(str, (frame, *np.minimum(gain * weights, 1)))))
        keys = tmp_path / "keys.csv"
        keys.write_text("\n".join(table) + "\n")
        execute(ReferencesImportSpec(references=references, weights=keys, author=author))
    trained = execute(TrainSpec(references=references, out=out, method="face_map"), overwrite=True)
    note = next(note for note in trained.notes if "differ in gain" in note)
    assert "mean gain by author: anna 1.1" in note
    assert ", ben 0." in note


def test_motion_of_shapes_combinations_and_in_betweens_adds_up_to_that_of_the_rig() -> None:
    """Also if one shape drives a combination, or a combination has in-betweens' shapes as parts."""
    rig, rng = small_rig(), np.random.default_rng(1)
    combinations = (
        Combination("crease", ("smile",)),
        Combination("mid", ("smile",), weights=(0.4,)),
        Combination("squint", ("eyeBlink", "jawOpen"), weights=(0.5, 1.0)),
    )
    driven = tuple(
        MeshShape(each.shape, (ShapeKey(1.0, np.arange(12), rng.normal(size=(12, 3))),))
        for each in combinations
    )
    skin = replace(rig.meshes[0], shapes=(*rig.meshes[0].shapes, *driven))
    rig = replace(rig, meshes=(skin, *rig.meshes[1:]), combinations=combinations)
    deformer, weights = Deformer(rig), rng.random((40, len(rig.shapes)))
    points = np.arange(len(deformer.neutral))
    between, motion = train.separate_motion(rig, deformer, points, rig.shapes)
    logic = logic_of(rig.shapes, (*combinations, *between))
    assert logic is not None
    every = np.concatenate([weights, driven_weights(logic, weights)], axis=1)
    moved = np.tensordot(every, motion, 1)
    np.testing.assert_allclose(moved, deformer.shapes.offsets(weights), atol=1e-9)
