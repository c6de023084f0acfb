"""References of a rig with combination shapes, through every command that reads or extends them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from tests.steps.small_shot import Shot
from usdface.core.assets import MeshShape, ShapeKey
from usdface.core.rig_logic import Combination
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, EditSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import ReferencesAddSpec, ReferencesImportSpec, SelectSpec
from usdface.specs.retarget import PairsImportSpec
from usdface.specs.review import EvaluateSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

pytestmark = pytest.mark.usefixtures(
    "without_comparison", "placement_not_drawn", "coverage_not_drawn"
)

COUNT = 12
DRIVEN = (
    Combination("jaw_smile", ("jawOpen", "mouthSmileLeft")),
    Combination("blink50", ("eyeBlinkLeft",), weights=(0.5,)),
)


@pytest.fixture
def driven(shot: Shot) -> Path:
    """The shot's rig with a combination and an in-between."""
    rig = read_rig(shot / "hero.usdc")
    skin, *others = rig.meshes
    bulge = ShapeKey(1.0, np.arange(5), np.full((5, 3), 0.5))
    more = tuple(MeshShape(each.shape, (bulge,)) for each in DRIVEN)
    meshes = (replace(skin, shapes=(*skin.shapes, *more)), *others)
    write_rig(shot / "driven.usdc", replace(rig, meshes=meshes, combinations=DRIVEN))
    return shot / "driven.usdc"


def test_pairs_are_chosen_tuned_extended_and_evaluated(shot: Shot, driven: Path) -> None:
    take, out = shot / "shot.clean.take.usda", shot / "driven.references.usda"
    execute(SelectSpec(takes=(take,), rig=driven, out=out, count=COUNT))
    execute(ReferencesImportSpec(references=out, weights=shot / "keys.csv"))
    tuned = read_references(out)
    execute(SelectSpec(takes=(take,), rig=driven, out=out, count=COUNT + 2), overwrite=True)
    more = read_references(out)
    np.testing.assert_array_equal(more.frames[:COUNT], tuned.frames)
    np.testing.assert_array_equal(more.weights[:COUNT], tuned.weights)
    np.testing.assert_array_equal(more.tuned, np.arange(COUNT + 2) < COUNT)

    mapping, solved = shot / "driven.mapping.usdc", shot / "driven.usda"
    execute(TrainSpec(references=out, out=mapping, method="face_map"))
    execute(MapSpec(take=take, mapping=mapping, rig=driven, out=solved))
    frame = next(frame for frame in range(1, 400) if frame not in more.frames)
    added = shot / "added.references.usda"
    execute(ReferencesAddSpec(performance=solved, references=out, frames=str(frame), out=added))
    assert read_references(added).frames[-1] == frame

    result = execute(EvaluateSpec(performance=solved, against=solved))
    assert not [note for note in result.notes if "not on the rig" in note]

    pairs = PairsImportSpec(
        source=solved,
        target=solved,
        source_rig=driven,
        target_rig=driven,
        out=shot / "driven.pairs.usda",
    )
    assert not [note for note in execute(pairs).notes if "left out" in note]

    baked = shot / "baked.usdc"
    execute(EditSpec(performance=solved, shape=("jawOpen",), override=0.5, frames="100-200"))
    execute(BakeSpec(performance=solved, out=baked))
    weights = PerformanceReader(baked).edited()
    moved = driven.rename(shot / "moved.usdc")
    execute(ReferencesImportSpec(references=out, weights=shot / "keys.csv", rig=moved))
    execute(TrainSpec(references=out, out=mapping, method="face_map", rig=moved), overwrite=True)
    execute(BakeSpec(performance=solved, out=baked, rig=moved), overwrite=True)
    np.testing.assert_array_equal(PerformanceReader(baked).edited(), weights)


def with_two_faces(path: Path, rig: Path) -> Path:
    """Write a stage with a rig twice."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(stage.DefinePrim("/shot", "Xform"))
    for name in ("left", "right"):
        stage.DefinePrim(f"/shot/{name}").GetReferences().AddReference(rig.name)
    stage.Save()
    return path


def test_one_of_two_faces_in_a_stage(shot: Shot, driven: Path) -> None:
    two = with_two_faces(shot / "two.usda", driven)
    take, out = shot / "shot.clean.take.usda", shot / "two.references.usda"
    execute(SelectSpec(takes=(take,), rig=two, prim="/shot/right", out=out, count=COUNT))
    execute(ReferencesImportSpec(references=out, weights=shot / "keys.csv"))
    before = read_references(out)
    assert [each.shape for each in before.combinations] == [each.shape for each in DRIVEN]
    mapping, solved = shot / "two.mapping.usdc", shot / "two.hero.usda"
    execute(TrainSpec(references=out, out=mapping, method="face_map"))
    execute(MapSpec(take=take, mapping=mapping, rig=two, rig_prim="/shot/right", out=solved))
