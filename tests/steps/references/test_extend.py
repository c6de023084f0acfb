"""References that are extended in place keep what people did in them."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Vt

from tests.steps.small_shot import Shot
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import proposed_path, tuned_path
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec
from usdface.specs.references import (
    ReferencesAddSpec,
    ReferencesFromEditsSpec,
    ReferencesImportSpec,
)
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession
from usdface.usdio.authoring import author_series
from usdface.usdio.references.read import WEIGHTS_PATH, read_references
from usdface.usdio.references.weight_layers import read_proposals, read_tuned_pairs
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

pytestmark = pytest.mark.usefixtures("placement_not_drawn", "coverage_not_drawn")

NEW = "7,333"


def add(shot: Shot, asset: Path, **more: object) -> References:
    given = {"performance": shot / "shot.hero.usda", "references": asset, "frames": NEW}
    execute(ReferencesAddSpec.model_validate({**given, "out": asset, **more}), overwrite=True)
    return read_references(asset)


def test_pairs_in_work_stay_so_and_keep_their_proposals(shot: Shot) -> None:
    asset = shot / "hero.references.usda"
    session = TuningSession(asset)
    pairs, shape = session.references, session.references.shape_names[0]
    change = Change(2, pairs.takes[2], int(pairs.frames[2]), {shape: 0.125}, False)
    session.apply([change], revision=session.revision)
    session.close()
    before, tuned = read_references(asset), read_tuned_pairs(tuned_path(asset))
    proposed = read_proposals(proposed_path(asset), before)
    assert [each.pair for each in tuned if not each.done] == [2]
    after = add(shot, asset)
    assert read_tuned_pairs(tuned_path(asset)) == tuned
    np.testing.assert_array_equal(after.weights[:-2], before.weights)
    np.testing.assert_array_equal(read_proposals(proposed_path(asset), after)[:-2], proposed)
    other = shot / "v2.references.usda"
    add(shot, asset, frames="9,345", out=other)
    assert read_tuned_pairs(tuned_path(other)) == tuned


def key_in_a_dcc(asset: Path) -> str:
    """Key a shape of nine pairs in the asset itself, untuned before; return its name."""
    tuned_path(asset).unlink()
    layer = Sdf.Layer.FindOrOpen(str(proposed_path(asset)))
    names = list(layer.GetPrimAtPath(WEIGHTS_PATH).attributes["blendShapes"].default)
    path = WEIGHTS_PATH.AppendProperty("blendShapeWeights")
    times = layer.ListTimeSamplesForPath(path)
    weights = np.array([layer.QueryTimeSample(path, time) for time in times])
    weights[:9, 0] = 0.75
    Sdf.Layer.CreateNew(str(tuned_path(asset))).Save()
    keyed = Sdf.Layer.FindOrOpen(str(asset))
    rows = map(Vt.FloatArray.FromNumpy, weights)
    author_series(keyed.GetPrimAtPath(WEIGHTS_PATH), path.name, Sdf.ValueTypeNames.FloatArray, rows)
    keyed.Save()
    return str(names[0])


def test_pairs_keyed_in_a_dcc_are_tuned_afterwards(shot: Shot) -> None:
    asset = shot / "hero.references.usda"
    shape = key_in_a_dcc(asset)
    assert not read_references(asset).tuned.any()
    after = add(shot, asset)
    assert np.flatnonzero(after.tuned).tolist() == list(range(9))
    assert (after.weights[:9, after.shape_names.index(shape)] == 0.75).all()


def test_keys_that_hide_the_tuned_layer_are_named_before_anything_is_tuned(shot: Shot) -> None:
    asset, told = shot / "hero.references.usda", r"its keys in hero.references.usda would hide"
    key_in_a_dcc(asset)
    before = tuned_path(asset).read_bytes()
    with pytest.raises(InputError, match=told):
        TuningSession(asset)
    imported = ReferencesImportSpec(references=asset, weights=shot / "keys.csv")
    with pytest.raises(InputError, match=told):
        execute(imported, overwrite=True)
    assert tuned_path(asset).read_bytes() == before


def test_frames_that_another_take_lacks_are_no_pairs(shot: Shot) -> None:
    performance, clean = shot / "shot.hero.usda", shot / "shot.clean.take.usda"
    (shot / "cut").mkdir()
    cut = shot / "cut" / "shot.clean.take.usda"
    take = read_take(clean)
    assert take.markers is not None
    kept = {
        name: getattr(take.markers, name)[99:] for name in ("positions", "visible", "confidence")
    }
    markers = replace(take.markers, **kept, neutral_frame=120)
    write_take(cut, replace(take, markers=markers, first_frame=100), provenance=Provenance("clean"))
    asset = shutil.copy(shot / "hero.references.usda", shot / "v2.references.usda")
    told = r"cut.*has frames 100-480, so not {} of the performance; give the take"
    with pytest.raises(InputError, match=told.format("7")):
        add(shot, shot / "hero.references.usda", take=cut)
    edit = {"performance": performance, "shape": ("jawOpen",), "override": 0.8}
    execute(EditSpec.model_validate({**edit, "frames": "40-41", "fade": 0}))
    given = {"performances": (performance,), "references": shot / "hero.references.usda"}
    spec = ReferencesFromEditsSpec.model_validate({**given, "take": (cut,), "out": asset})
    with pytest.raises(InputError, match=told.format("40, 41")):
        execute(spec, overwrite=True)
    write_take(shot / "other.usda", replace(take, name="other"), provenance=Provenance())
    another = spec.model_copy(update={"take": (shot / "other.usda",)})
    with pytest.raises(InputError, match=r"is not the take of .*shot\.hero\.usda; leave out"):
        execute(another, overwrite=True)
