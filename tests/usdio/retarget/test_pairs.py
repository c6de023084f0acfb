"""Pairs, retargetings, sequences and matches to disk and back; what is wrong with them is named."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Ts, Usd, UsdSkel

from tests.usdio.small_creature import (
    RATE,
    creature_acts,
    human_moves,
    write_creature,
    write_human,
)
from usdface.core.assets import Rig
from usdface.core.controls import EmotionalSequence, ExpressionPairs, SequenceMatch
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.core.sidecars import proposed_path
from usdface.model.retarget.train import retarget, train_retargeting
from usdface.usdio.layers import read_provenance
from usdface.usdio.retarget.pairs import keyed_above, merge_pairs, read_pairs, write_pairs
from usdface.usdio.retarget.retargeting import is_retargeting, read_retargeting, write_retargeting
from usdface.usdio.retarget.sequences import (
    read_matches,
    read_sequence,
    write_matches,
    write_sequence,
)
from usdface.usdio.validation import validate


def some_pairs(human: Rig, beast: Rig, count: int = 8) -> ExpressionPairs:
    source = np.concatenate([np.zeros((1, 3)), np.random.default_rng(0).random((count - 1, 3))])
    return ExpressionPairs(
        names=tuple(f"expression {index}" for index in range(count)),
        source_shapes=human.shapes,
        source=source,
        target=creature_acts(source),
        source_rig=human.file,
        source_prim=human.prim,
        target_rig=beast.file,
        target_prim=beast.prim,
    )


def layer_above(path: Path) -> Path:
    """Write an empty layer above another one, in a folder of its own."""
    layer = Sdf.Layer.CreateAnonymous()
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(path)))
    for prim in list(layer.rootPrims):
        del layer.rootPrims[prim.name]
    layer.subLayerPaths = [f"../{path.name}"]
    above = path.parent / "above" / path.name
    layer.Export(str(above))
    return above


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, ExpressionPairs]:
    human, beast = write_human(tmp_path / "human.usda"), write_creature(tmp_path / "beast.usda")
    pairs = some_pairs(human, beast)
    write_pairs(
        tmp_path / "x.pairs.usda",
        pairs,
        source_rig=human,
        target_rig=beast,
        provenance=Provenance(),
    )
    return tmp_path / "x.pairs.usda", pairs


def test_samples_are_not_replaced_where_the_layer_to_open_cannot_be(
    written: tuple[Path, ExpressionPairs],
) -> None:
    path, _ = written
    human, beast = write_human(path.with_name("h.usda")), write_creature(path.with_name("b.usda"))
    before = {each.name: each.read_bytes() for each in path.parent.iterdir()}
    with pytest.raises(InputError, match="another process is writing it"), replacing(path):
        write_pairs(
            path,
            some_pairs(human, beast, 5),
            source_rig=human,
            target_rig=beast,
            provenance=Provenance(),
        )
    assert {each.name: each.read_bytes() for each in path.parent.iterdir()} == before


def test_pairs_come_back_as_they_were_written(written: tuple[Path, ExpressionPairs]) -> None:
    path, pairs = written
    back = read_pairs(path)
    assert back.names == pairs.names
    assert back.source_shapes == pairs.source_shapes
    np.testing.assert_allclose(back.source, pairs.source, atol=1e-6)
    np.testing.assert_allclose(back.target.weights, pairs.target.weights, atol=1e-6)
    np.testing.assert_allclose(back.target.values, pairs.target.values, atol=1e-6)
    np.testing.assert_allclose(back.target.rotations, pairs.target.rotations, atol=1e-6)
    assert back.source_rig is not None
    assert back.source_rig.resolve() == pairs.source_rig.resolve()
    assert back.target_prim == pairs.target_prim
    assert not [each for each in validate(path) if each.severity == "error"]


def test_scrubbing_poses_both_faces(written: tuple[Path, ExpressionPairs]) -> None:
    path, pairs = written
    stage = Usd.Stage.Open(str(path))
    for side, weights in (("Source", pairs.source), ("Target", pairs.target.weights)):
        root = UsdSkel.Root(stage.GetPrimAtPath(f"/Pairs/{side}"))
        cache = UsdSkel.Cache()
        cache.Populate(root, Usd.PrimDefaultPredicate)
        query = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, f"/Pairs/{side}/rig/skeleton"))
        posed = query.GetAnimQuery().ComputeBlendShapeWeights(3)
        np.testing.assert_allclose(posed, weights[2], atol=1e-6)


def test_what_an_animator_keys_above_goes_before_what_was_proposed(
    written: tuple[Path, ExpressionPairs],
) -> None:
    path, pairs = written
    stage = Usd.Stage.Open(str(path))
    weights = UsdSkel.Animation.Get(stage, "/Pairs/TargetControls").GetBlendShapeWeightsAttr()
    for time in range(1, 9):
        weights.Set([0.5, 0.5, 0.1 * time], time)
    layer = stage.GetRootLayer()
    layer.subLayerPaths = ["x.pairs.proposed.usda"]  # as another tool writes it
    layer.Save()
    human = write_human(path.parent / "human.usda")
    beast = write_creature(path.parent / "beast.usda")
    write_pairs(path, pairs, source_rig=human, target_rig=beast, provenance=Provenance())
    np.testing.assert_allclose(
        read_pairs(path).target.weights[:, 2], 0.1 * np.arange(1, 9), atol=1e-6
    )
    assert list(layer.subLayerPaths) == ["x.pairs.proposed.usda"]


def test_controls_that_are_keyed_as_splines_are_keys(
    written: tuple[Path, ExpressionPairs],
) -> None:
    path, _ = written
    assert not keyed_above(path)
    stage = Usd.Stage.Open(str(path))
    curl, spline = stage.GetAttributeAtPath("/Pairs/Target/rig/lattice.dfm:curl"), Ts.Spline()
    spline.SetKnot(Ts.Knot(time=8, value=0.5))
    curl.SetSpline(spline)
    stage.Save()
    assert keyed_above(path) == (str(curl.GetPath()),)
    np.testing.assert_allclose(read_pairs(path).target.values[:, 1], 0.5)
    spline.SetKnot(Ts.Knot(time=9, value=0.5))
    curl.SetSpline(spline)
    stage.Save()
    with pytest.raises(InputError, match="pair 9 has no source side"):
        read_pairs(path)


@pytest.mark.parametrize(
    ("prim", "side"), [("SourceWeights", "source"), ("TargetControls", "target")]
)
def test_a_pair_without_a_side_is_named(
    written: tuple[Path, ExpressionPairs], prim: str, side: str
) -> None:
    path, _ = written
    layer = Sdf.Layer.FindOrOpen(str(proposed_path(path)))
    for spec in layer.GetPrimAtPath(f"/Pairs/{prim}").attributes:
        layer.EraseTimeSample(spec.path, 5)
    if side == "target":
        for spec in layer.GetPrimAtPath("/Pairs/Target/rig/lattice").attributes:
            layer.EraseTimeSample(spec.path, 5)
    layer.Save()
    with pytest.raises(InputError, match=f"pair 5 has no {side} side.*time code 5"):
        read_pairs(path)


def test_an_attribute_that_is_gone_is_named(written: tuple[Path, ExpressionPairs]) -> None:
    path, _ = written
    layer = Sdf.Layer.FindOrOpen(str(proposed_path(path)))
    names = layer.GetAttributeAtPath("/Pairs/TargetControls.face:controls:attributes")
    names.default = ["rig/lattice.dfm:gone", "rig/lattice.dfm:curl"]
    layer.Save()
    with pytest.raises(InputError, match="has no attribute 'dfm:gone'"):
        read_pairs(path)


def test_a_file_without_pairs_is_refused(tmp_path: Path) -> None:
    write_human(tmp_path / "human.usda")
    with pytest.raises(InputError, match="not a pairs asset"):
        read_pairs(tmp_path / "human.usda")


def test_merging_keeps_old_time_codes_and_adds_what_is_new(
    written: tuple[Path, ExpressionPairs],
) -> None:
    _, pairs = written
    more = replace(pairs, names=("new", *pairs.names[1:]), source=pairs.source + 0.1)
    merged = merge_pairs(pairs, more)
    assert merged.names == (*pairs.names, "new")
    np.testing.assert_array_equal(merged.source[:8], pairs.source)
    np.testing.assert_array_equal(merged.source[8], pairs.source[0] + 0.1)
    with pytest.raises(InputError, match="choose another --out"):
        merge_pairs(pairs, replace(more, source_shapes=("a", "b", "c")))


def test_a_retargeting_predicts_the_same_to_the_last_bit(
    written: tuple[Path, ExpressionPairs],
) -> None:
    path, pairs = written
    for method in ("rbf", "kernel_cca", "hybrid", "additive", "ridge"):
        trained = train_retargeting(pairs, method=method)
        out = path.with_name(f"{method}.usdc")
        write_retargeting(out, trained, provenance=Provenance())
        back = read_retargeting(out)
        one, other = retarget(trained, human_moves(30)), retarget(back, human_moves(30))
        for field, value in vars(one).items():
            assert np.array_equal(value, getattr(other, field)), field
        assert back.scores == trained.scores
    assert is_retargeting(out)
    assert read_retargeting(layer_above(out)).target_rig == pairs.target_rig
    assert not is_retargeting(path)
    with pytest.raises(InputError, match="not a retargeting"):
        read_retargeting(path)


@pytest.mark.parametrize(
    ("attribute", "value", "told"),
    [
        ("array:rest", [1.0, 2.0], r"face:array:rest.*train again"),
        ("retargeting:channels", ["only"], r"face:array:rest has \d+ numbers.*train again"),
        ("retargeting:attributes", [], r"face:array:rest has \d+ numbers.*train again"),
        ("retargeting:joints", [], r"face:array:mean_rotations has \d+ numbers.*train again"),
        ("retargeting:source", ["a"], r"face:array:fit_source_rest has 3 numbers.*train again"),
    ],
)
def test_a_damaged_retargeting_is_refused(
    written: tuple[Path, ExpressionPairs], attribute: str, value: list, told: str
) -> None:
    path, pairs = written
    out = path.with_name("r.usda")
    write_retargeting(out, train_retargeting(pairs, method="ridge"), provenance=Provenance())
    layer = Sdf.Layer.FindOrOpen(str(out))
    layer.GetAttributeAtPath(f"/Retargeting/FaceRetargeting.face:{attribute}").default = value
    layer.Save()
    with pytest.raises(InputError, match=told):
        read_retargeting(out)


def test_a_retargeting_that_lacks_an_array_is_to_be_trained_again(
    written: tuple[Path, ExpressionPairs],
) -> None:
    path, pairs = written
    out = path.with_name("r.usda")
    write_retargeting(out, train_retargeting(pairs, method="ridge"), provenance=Provenance())
    layer = Sdf.Layer.FindOrOpen(str(out))
    prim = layer.GetPrimAtPath("/Retargeting/FaceRetargeting")
    for each in [each for each in prim.properties if "fit_unused" in each.name]:
        prim.RemoveProperty(each)
    layer.Save()
    with pytest.raises(InputError, match=r"face:array:fit_unused has 0 numbers.*train again"):
        read_retargeting(out)


def test_a_sequence_comes_back_with_sides_of_different_length(tmp_path: Path) -> None:
    target = creature_acts(human_moves(37))
    sequence = EmotionalSequence(
        label="surprise",
        source_shapes=("jawOpen", "eyeBlink", "smile"),
        source=human_moves(20),
        target=target,
        key_weights=np.linspace(0, 1, 37),
    )
    write_sequence(tmp_path / "s.usda", sequence, rate=RATE, provenance=Provenance())
    back = read_sequence(tmp_path / "s.usda")
    assert back.label == "surprise"
    np.testing.assert_allclose(back.source, sequence.source, atol=1e-6)
    np.testing.assert_allclose(back.target.values, target.values, atol=1e-6)
    np.testing.assert_allclose(back.target.translations, target.translations, atol=1e-6)
    np.testing.assert_allclose(back.key_weights, sequence.key_weights, atol=1e-6)
    assert not [each for each in validate(tmp_path / "s.usda") if each.severity == "error"]
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "s.usda"))
    layer.SetTimeSample("/Sequence.face:sequence:keyWeight", 3, float("nan"))
    layer.Save()
    with pytest.raises(InputError, match=r"keyWeight> time code 3: is not finite; correct the key"):
        read_sequence(tmp_path / "s.usda")
    with pytest.raises(InputError, match="not a sequence"):
        read_sequence(write_human(tmp_path / "human.usda").file)
    for time in layer.ListTimeSamplesForPath("/Sequence.face:sequence:keyWeight"):
        layer.SetTimeSample("/Sequence.face:sequence:keyWeight", time, 0.0)
    layer.Save()
    with pytest.raises(InputError, match=r"keyWeight>: no key has a weight above 0"):
        read_sequence(tmp_path / "s.usda")


def test_matches_come_back_and_deactivated_ones_do_not(tmp_path: Path) -> None:
    (tmp_path / "s.usda").touch()
    matches = tuple(
        SequenceMatch(tmp_path / "s.usda", "joy", first, first + 19, 0.1) for first in (10, 50)
    )
    write_matches(tmp_path / "m.usda", matches, rate=Fraction(30), provenance=Provenance())
    above = layer_above(tmp_path / "m.usda")
    for path in (tmp_path / "m.usda", above):
        back = read_matches(path, rate=Fraction(30))
        assert [each.sequence for each in back] == [tmp_path / "s.usda"] * 2
    with pytest.raises(
        InputError, match="of a take with 30 per second, not 60; find the sequences"
    ):
        read_matches(tmp_path / "m.usda", rate=Fraction(60))
    found = read_matches(tmp_path / "m.usda", rate=Fraction(30))
    assert [vars(m) | {"sequence": 0} for m in found] == [
        vars(m) | {"sequence": 0} for m in matches
    ]
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "m.usda"))
    layer.GetPrimAtPath("/Matches/match_001").active = False
    layer.Save()
    assert [m.first_frame for m in read_matches(tmp_path / "m.usda", rate=Fraction(30))] == [50]
    assert read_provenance(tmp_path / "m.usda") == Provenance()
    with pytest.raises(InputError, match="no </Matches>"):
        read_matches(write_human(tmp_path / "human.usda").file, rate=Fraction(24))
