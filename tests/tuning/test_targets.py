"""The live residual: markers glued to the rig, against where the captured ones should be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.numerics.small_face import SmallActor, SmallFace, small_actor, small_face
from usdface.core.assets import MeshShape, References, Rig, RigMesh, ShapeKey
from usdface.core.deformer import Deformer
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.placement.place import MarkerPlacement
from usdface.model.selection import baseline
from usdface.model.selection.baseline import PerformerMarkers, set_up_equation
from usdface.numerics.measure.face_regions import region_of_shape
from usdface.tuning.targets import MarkerTargets, find_targets, solve_shapes, targets_or_reason


def rig_of(face: SmallFace) -> Rig:
    everywhere = np.arange(len(face.points))
    mesh = RigMesh(
        path="/Hero/face",
        points=face.points,
        face_counts=np.full(len(face.triangles), 3),
        face_indices=face.triangles.ravel(),
        shapes=tuple(
            MeshShape(name, (ShapeKey(1.0, everywhere, offsets),))
            for name, offsets in zip(face.names, face.offsets, strict=True)
        ),
    )
    ranges = np.tile([0.0, 1.0], (len(face.names), 1))
    return Rig(Path("hero.usda"), "/Hero", face.names, (mesh,), ranges)


LABELS = {
    69: "nose_tip",
    52: "chin",
    66: "lip_lower_mid",
    57: "mouth_corner_L",
    2: "mouth_corner_R",
    56: "lip_lower_R",
}
"""Of markers near these features: so many place all others in a tenth of the time of motion."""


@pytest.fixture(scope="module")
def places() -> list[MarkerPlacement]:
    """Where `made` places its markers; all else here is asked of the same places."""
    return []


@pytest.fixture(scope="module")
def made(places: list[MarkerPlacement]) -> tuple[Rig, SmallActor, References, MarkerTargets]:
    face = small_face()
    actor = small_actor(face, np.random.default_rng(0))
    rig = rig_of(face)
    pairs = np.arange(0, 240, 10)
    references = References(
        marker_names=tuple(LABELS.get(i, f"m{i}") for i in range(len(actor.neutral))),
        shape_names=face.names,
        markers=actor.positions[pairs],
        weights=actor.weights[pairs],
        frames=pairs,
        takes=("take",) * len(pairs),
        tuned=np.zeros(len(pairs), dtype=np.bool_),
        rigid=(),
        neutral=actor.neutral,
        rig_file=rig.file,
        rig_prim=rig.prim,
    )
    place = baseline.place_markers

    def placing(*given: object, **named: object) -> MarkerPlacement:
        places.append(place(*given, **named))
        return places[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baseline, "place_markers", placing)
        return rig, actor, references, find_targets(references, rig)


def residual(rig: Rig, targets: MarkerTargets, weights: np.ndarray) -> np.ndarray:
    """What the page computes: (pairs, markers) [mm]."""
    shares = Deformer(rig).shapes.key_weights(weights)
    bound = targets.rest + np.einsum("pk,kmc->pmc", shares, targets.key_deltas)
    return np.linalg.norm(bound - targets.targets, axis=2)


def test_the_performed_weights_leave_little_and_rest_leaves_much(made) -> None:
    rig, _, references, targets = made
    performed = residual(rig, targets, references.weights)
    still = residual(rig, targets, np.zeros_like(references.weights))
    assert np.sqrt((performed**2).mean()) < 0.35 * np.sqrt((still**2).mean())


def test_each_wrong_shape_shows_in_its_own_region(made) -> None:
    rig, _, references, targets = made
    regions = np.array(targets.regions)
    weights = references.weights.copy()
    base = residual(rig, targets, weights)
    weights[:, references.shape_names.index("browUpL")] += 0.8
    worse = residual(rig, targets, weights) - base
    by_region = {name: worse[:, regions == name].mean() for name in set(targets.regions)}
    assert max(by_region, key=by_region.get) == "brows"


def test_every_marker_has_a_region_unless_it_is_rigid(made) -> None:
    _, _, references, targets = made
    assert len(targets.regions) == len(references.marker_names)
    assert "" not in targets.regions
    assert {"mouth", "brows", "lids"} <= set(targets.regions)


def test_some_shapes_are_solved_while_the_others_hold(made) -> None:
    rig, _, references, targets = made
    names = list(references.shape_names)
    mouth = np.array([region_of_shape(name) == "mouth" for name in names])
    assert 1 < mouth.sum() < len(names)
    pair = int(references.weights[:, mouth].sum(axis=1).argmax())
    every = solve_shapes(references, targets, pair, np.zeros(len(names)), np.ones(len(names), bool))
    proposed = targets.equation.propose(references.markers[pair : pair + 1])[0]
    np.testing.assert_allclose(every, proposed, atol=1e-9)
    away = np.where(mouth, 0.0, proposed)
    found = solve_shapes(references, targets, pair, away, mouth)
    np.testing.assert_array_equal(found[~mouth], away[~mouth])
    np.testing.assert_allclose(found, proposed, atol=0.02)
    held = mouth.copy()
    held[np.flatnonzero(mouth)[0]] = False
    away[np.flatnonzero(mouth)[0]] = -0.25  # beyond the range, and a person wants it so
    found = solve_shapes(references, targets, pair, away, held)
    np.testing.assert_array_equal(found[~held], away[~held])
    at = targets.targets[pair]
    keys = Deformer(rig).shapes.key_weights(np.array([away, found]))
    bound = targets.rest + np.einsum("pk,kmc->pmc", keys, targets.key_deltas)
    before, after = np.linalg.norm(bound - at, axis=2).mean(axis=1)
    assert after < before
    low, high = rig.ranges.T
    assert ((found >= low) & (found <= high))[held].all()


def test_targets_do_not_move_with_a_head_band_that_slips(made, places, monkeypatch) -> None:
    rig, actor, references, targets = made
    monkeypatch.setattr(baseline, "place_markers", lambda *given, **named: places[0])
    rng = np.random.default_rng(1)
    moves = rng.normal(0, 3, (len(actor.positions), 1, 3))
    slipped = replace(
        references,
        motion=fit_motion_space([actor.positions + moves]),
        markers=(references.markers + moves[references.frames]).astype(np.float32),
    )
    away = np.linalg.norm(find_targets(slipped, rig).targets - targets.targets, axis=2)
    assert np.sqrt((away**2).mean()) < 1.5  # of 5.2


def test_blinks_are_judged_take_by_take_as_by_select(made, places, monkeypatch) -> None:
    """The lids of one take lie lower than those of the other, by another head pose."""
    rig, actor, references, targets = made
    monkeypatch.setattr(baseline, "place_markers", lambda *given, **named: places[0])
    clips = [actor.positions[:160].copy(), actor.positions[160:].copy()]
    lids = np.array(targets.regions) == "lids"
    clips[1][:, lids, 1] -= 3.0
    both = replace(references, motion=fit_motion_space(clips))
    page = find_targets(both, rig).equation.lids
    assert page is not None
    peaks = []
    for starts in ((0, 160), (0,)):
        positions = np.concatenate(clips)
        seen = np.ones(positions.shape[:2], np.bool_)
        performer = PerformerMarkers(
            references.marker_names, references.neutral, positions, seen, (), starts
        )
        equation = set_up_equation(rig, Deformer(rig), performer)
        assert equation.lids is not None
        peaks.append(equation.lids.seen.independent_peaks)
    np.testing.assert_allclose(page.seen.independent_peaks, peaks[0], atol=0.02)
    assert np.abs(peaks[1] - peaks[0]).max() > 0.1


def test_references_without_markers_give_the_reason(made) -> None:
    rig, _, references, _ = made
    bare = References(**(vars(references) | {"marker_names": ()}))
    assert targets_or_reason(bare, rig) == "the references hold no markers"
