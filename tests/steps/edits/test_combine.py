"""Several takes on one character: a variant for each."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, CombineSpec, EditSpec, PackageSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

SHAPES = ("jawOpen", "eyeBlink", "smile")


def perform(path: Path, weights: np.ndarray, *, rate: int = 24, first: int = 1, place=None) -> Path:
    rig = read_rig(path.with_name("rig.usda"))
    header = make_header(
        rig,
        shape_names=SHAPES,
        rate=Fraction(rate),
        first_frame=first,
        last_frame=first + len(weights) - 1,
        rig_path=place,
    )
    with writing_performance(path, header, rig) as writer:
        writer.append(weights)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_rig(tmp_path / "rig.usda", small_rig())
    return tmp_path


def test_every_take_plays_on_the_character_by_its_variant(folder: Path) -> None:
    weights = np.random.default_rng(0).random((2, 6, 3)).astype(np.float32)
    paths = (
        perform(folder / "kitchen.hero.usda", weights[0], first=101),
        perform(folder / "stairs.hero.usda", weights[1]),
    )
    out = folder / "hero.takes.usda"
    report = execute(CombineSpec(performances=paths, out=out))
    assert report.figures["takes"] == {"kitchen": [101, 106], "stairs": [1, 6]}
    stage = Usd.Stage.Open(str(out))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 106)
    chosen = stage.GetDefaultPrim().GetVariantSet("take")
    assert chosen.GetVariantSelection() == "kitchen"
    for name, first, expected in (("kitchen", 101, weights[0]), ("stairs", 1, weights[1])):
        assert chosen.SetVariantSelection(name)
        meshes = [each for each in stage.Traverse() if each.IsA(UsdSkel.Skeleton)]
        source = UsdSkel.BindingAPI(meshes[0]).GetInheritedAnimationSource()
        attribute = UsdSkel.Animation(source).GetBlendShapeWeightsAttr()
        found = np.array([attribute.Get(first + frame) for frame in range(6)])
        np.testing.assert_array_equal(found, expected)
    assert np.array_equal(PerformanceReader(out).edited(), weights[0])
    assert [each.message for each in validate(out) if each.severity == "error"] == []


def test_what_is_made_of_the_take_that_is_shown_says_so(folder: Path) -> None:
    paths = tuple(perform(folder / f"{name}.hero.usda", np.ones((4, 3))) for name in ("a", "b"))
    out = folder / "hero.takes.usda"
    execute(CombineSpec(performances=paths, out=out))
    for spec in (
        BakeSpec(performance=out, out=folder / "baked.usdc"),
        PackageSpec(performance=out, out=folder / "packed.usdz"),
    ):
        assert any("of the takes a, b, only a is used" in note for note in execute(spec).notes)
    alone = execute(BakeSpec(performance=paths[0], out=folder / "alone.usdc"))
    assert not any("is used" in note for note in alone.notes)


def test_takes_keep_their_names_in_any_script(folder: Path) -> None:
    names = ("küche", "cu\u0308che", "日本_1", "a b")
    paths = tuple(perform(folder / f"{name}.hero.usda", np.zeros((2, 3))) for name in names)
    execute(CombineSpec(performances=paths, out=folder / "takes.usda"))
    stage = Usd.Stage.Open(str(folder / "takes.usda"))
    found = stage.GetDefaultPrim().GetVariantSet("take").GetVariantNames()
    assert sorted(found) == sorted((*names[:3], "a_b"))


def test_an_edit_of_one_take_does_not_change_the_others(folder: Path) -> None:
    weights = np.random.default_rng(0).random((2, 6, 3)).astype(np.float32)
    paths = tuple(perform(folder / f"{i}.usda", each) for i, each in enumerate(weights))
    execute(CombineSpec(performances=paths, out=folder / "takes.usda"))
    change = {"shape": ("jawOpen",), "add": 0.2}
    with pytest.raises(InputError, match=r"takes\.usda: its takes 0, 1 are variants, .* edit the"):
        execute(EditSpec(performance=folder / "takes.usda", **change))
    assert not (folder / "takes.edits.usda").exists()
    execute(EditSpec(performance=paths[0], **change))
    stage = Usd.Stage.Open(str(folder / "takes.usda"))
    for name, added in (("0", 0.2), ("1", 0)):
        stage.GetDefaultPrim().GetVariantSet("take").SetVariantSelection(name)
        stage.GetRootLayer().Export(str(folder / "shown.usda"))
        expected = weights[int(name)] + [added, 0, 0]
        np.testing.assert_allclose(PerformanceReader(folder / "shown.usda").edited(), expected)


def test_what_does_not_belong_together_is_refused(folder: Path) -> None:
    weights = np.random.default_rng(0).random((4, 3))
    one = perform(folder / "a.usda", weights)
    slow = perform(folder / "b.usda", weights, rate=25)
    away = perform(folder / "c.usda", weights, place="/shot/Hero")
    (folder / "other").mkdir()
    write_rig(folder / "other" / "rig.usda", small_rig())
    other = perform(folder / "other" / "a.usda", weights)
    out = folder / "takes.usda"
    for second, message in (
        (slow, "runs at 25 frames per second, and .* at 24"),
        (away, "has the rig at </shot/Hero>"),
        (folder / "other" / "a.usda", "two performances would be named a"),
    ):
        with pytest.raises(InputError, match=message):
            execute(CombineSpec(performances=(one, second), out=out))
    with pytest.raises(InputError, match=r"is of .*other.*rig\.usda"):
        execute(CombineSpec(performances=(one, other), out=out, takes=("a", "b")))
    assert not out.exists()
