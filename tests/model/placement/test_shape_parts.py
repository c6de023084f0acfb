"""Parts of the face of shapes with foreign names, by what they move."""

from dataclasses import replace

import numpy as np
import pytest

from tests.steps.small_shot import coarse_rig
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.demo.sculpt import ACTOR
from usdface.model.placement.shape_parts import missing_parts_note, shape_parts
from usdface.numerics.measure.face_regions import (
    REGIONS,
    gaze_shapes,
    jaw_opener,
    points_by_region,
    region_of_shape,
    tongue_shapes,
)


def with_names(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return a rig whose shapes have other names; `shapes` alone is read by `shape_parts`."""
    return replace(rig, shapes=names)


@pytest.fixture(scope="module", params=["hero", "actor"])
def rig(request: pytest.FixtureRequest) -> Rig:
    return coarse_rig() if request.param == "hero" else coarse_rig(ACTOR)


def test_foreign_names_give_the_same_points_as_known_ones(rig: Rig) -> None:
    deformer = Deformer(rig)
    foreign = tuple(f"Form_{index}" for index in range(len(rig.shapes)))
    parts = shape_parts(with_names(rig, foreign), deformer)
    assert [region_of_shape(part) for part in parts] == list(map(region_of_shape, rig.shapes))
    assert gaze_shapes(parts).tolist() == gaze_shapes(rig.shapes).tolist()
    assert tongue_shapes(parts).tolist() == tongue_shapes(rig.shapes).tolist()
    offsets = deformer.shapes.target_offsets()
    found, named = (points_by_region(offsets, names) for names in (parts, rig.shapes))
    assert list(found) == list(named)
    for region, points in named.items():
        assert np.array_equal(found[region], points), region
    assert missing_parts_note(parts) == ""


def test_brows_that_are_a_mesh_of_their_own_are_no_tongue() -> None:
    rig = coarse_rig()
    cards = tuple(
        mesh
        if mesh.path.endswith("brows")
        else replace(mesh, shapes=tuple(s for s in mesh.shapes if not s.name.startswith("brow")))
        for mesh in rig.meshes
    )
    foreign = tuple(f"Form_{index}" for index in range(len(rig.shapes)))
    deformer = Deformer(replace(rig, meshes=cards))
    parts = dict(zip(rig.shapes, shape_parts(with_names(rig, foreign), deformer), strict=True))
    assert {part for name, part in parts.items() if name.startswith("brow")} == {"brows"}


def test_a_shape_whose_name_is_known_keeps_it(rig: Rig) -> None:
    assert shape_parts(rig, Deformer(rig)) == rig.shapes
    some = {"browInnerUp": "Braue_innen_hoch", "eyeLookInLeft": "Blick_innen_L"}
    names = tuple(some.get(name, name) for name in rig.shapes)
    parts = dict(zip(rig.shapes, shape_parts(with_names(rig, names), Deformer(rig)), strict=True))
    assert parts.pop("browInnerUp") == "brows"
    assert parts.pop("eyeLookInLeft") == "gaze"
    assert all(part == name for name, part in parts.items())


def test_an_open_mouth_is_an_open_jaw() -> None:
    rig = coarse_rig()
    names = tuple("mouthOpen" if name == "jawOpen" else name for name in rig.shapes)
    parts = shape_parts(with_names(rig, names), Deformer(rig))
    assert jaw_opener(parts) == rig.shapes.index("jawOpen")
    assert parts == tuple("jawopen" if name == "mouthOpen" else name for name in names)


def test_where_no_eyes_and_mouth_are_found_names_stay_and_a_note_says_what_is_missing() -> None:
    rig = coarse_rig()
    names = tuple("" if name.startswith(("eyeBlink", "jaw")) else name for name in rig.shapes)
    bare = replace(
        rig,
        meshes=tuple(
            replace(mesh, shapes=tuple(each for each in mesh.shapes if each.name in names))
            for mesh in rig.meshes
        ),
        shapes=tuple(filter(None, names)),
        ranges=np.tile([0.0, 1.0], (len(list(filter(None, names))), 1)),
    )
    foreign = tuple(f"Form_{i}" for i in range(len(bare.shapes)))
    parts = shape_parts(with_names(bare, foreign), Deformer(bare))
    assert parts == foreign
    note = missing_parts_note(parts)
    assert note.startswith("no shape of this rig is known to move the brows, lids, cheeks and nose")
    whole = ("browUp", "nose", "mouthSmile", "jawOpen")
    assert missing_parts_note((*whole, "eyeSquint_L", "eyeWide_L")).startswith(
        "no shape of this rig closes the eyes"
    )
    assert not missing_parts_note((*whole, "eyeSquint_L", "eyeBlink_L"))
    assert not missing_parts_note((*whole, "eyeSquint_L", "lids"))  # found by its displacements
    assert missing_parts_note(("browUp", "lids", "nose", "jawOpen")).startswith(
        "no shape of this rig is known to move the mouth:"
    )


def test_action_units_need_no_landmarks() -> None:
    units = ("AU1_L", "AU45_R", "AU9_L", "AU12_R", "AU26")
    rig = coarse_rig()
    others = tuple(f"Form_{index}" for index in range(len(rig.shapes) - len(units)))
    still = replace(
        rig, meshes=tuple(replace(mesh, shapes=()) for mesh in rig.meshes)
    )  # nothing shows eyes or a mouth
    parts = shape_parts(with_names(still, units + others), Deformer(still))
    assert [region_of_shape(part) for part in parts[: len(units)]] == list(REGIONS)
    assert parts[len(units) :] == others
