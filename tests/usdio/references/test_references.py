"""References: pairs on a timeline, and tuning that no proposal can touch."""

import contextlib
import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.usdio.small_rig import small_rig
from usdface.core.assets import MotionSpace, References
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import samples_path
from usdface.core.trajectories import TRAJECTORY_SECONDS
from usdface.usdio.references.read import PLACEMENT, TRAJECTORY_TIMES, read_references
from usdface.usdio.references.weight_layers import TunedPair, read_tuned_pairs
from usdface.usdio.references.write import write_references, write_tuned_weights
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

NOT_FINITE = MotionSpace(np.full(12, np.nan), np.ones((3, 12)), np.ones(3), 3.0, np.ones((20, 3)))


def small_references(folder: Path, pairs: int = 5, seed: int = 0) -> References:
    rng = np.random.default_rng(seed)
    components = np.linalg.qr(rng.normal(size=(12, 3)))[0].T
    return References(
        marker_names=("a", "b", "c", "d"),
        shape_names=("jawOpen", "eyeBlink", "smile"),
        markers=rng.normal(0, 50, (pairs, 4, 3)),
        weights=rng.random((pairs, 3)).astype(np.float32).astype(np.float64),
        frames=np.arange(pairs) * 7 + 100 * seed,
        takes=("kitchen",) * pairs,
        tuned=np.zeros(pairs, dtype=np.bool_),
        rigid=("a", "b", "c"),
        neutral=rng.normal(0, 50, (4, 3)),
        rig_file=folder / "rig.usda",
        rig_prim="/Hero",
        rate=30000 / 1001,
        motion=MotionSpace(
            mean=rng.normal(0, 50, 12),
            components=components,
            variances=np.array([9.0, 4.0, 1.0]),
            total_variance=15.0,
            sample=rng.normal(size=(20, 3)),
            sample_starts=(0, 12),
        ),
    )


def write(folder: Path, references: References) -> Path:
    if not (folder / "rig.usda").exists():
        write_rig(folder / "rig.usda", small_rig())
    path = folder / "hero.references.usda"
    write_references(path, references, read_rig(folder / "rig.usda"), provenance=Provenance())
    return path


def tune(folder: Path, references: References, pairs: dict[int, float]) -> None:
    tuned = [
        TunedPair(
            pair,
            references.takes[pair],
            int(references.frames[pair]),
            dict.fromkeys(references.shape_names, value),
        )
        for pair, value in pairs.items()
    ]
    write_tuned_weights(
        references, tuned, layer_path=folder / "hero.references.tuned.usda", provenance=Provenance()
    )


def test_references_read_back_the_same(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    back = read_references(write(tmp_path, references))
    for field in ("marker_names", "shape_names", "takes", "rigid", "rig_prim", "rate"):
        assert getattr(back, field) == getattr(references, field)
    for field in ("weights", "frames", "tuned"):
        np.testing.assert_array_equal(getattr(back, field), getattr(references, field))
    np.testing.assert_allclose(back.markers, references.markers, rtol=1e-6)
    np.testing.assert_allclose(back.neutral, references.neutral, rtol=1e-12)
    assert back.rig_file.resolve() == references.rig_file.resolve()
    assert back.motion is not None
    assert back.motion.sample_starts == (0, 12)
    for field in ("mean", "components", "variances", "sample", "total_variance"):
        np.testing.assert_allclose(
            getattr(back.motion, field), getattr(references.motion, field), rtol=1e-12
        )


def test_motion_about_the_pairs_is_read_at_the_same_times_only(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    rng = np.random.default_rng(1)
    moved = rng.normal(0, 5, (5, len(TRAJECTORY_SECONDS), 4, 3))
    path = write(tmp_path, replace(references, trajectories=moved))
    back = read_references(path)
    assert back.trajectories is not None
    np.testing.assert_allclose(back.trajectories, moved, atol=1e-4)
    some = back.rows(np.array([3, 1])).trajectories
    np.testing.assert_array_equal(some, back.trajectories[[3, 1]])
    samples = Sdf.Layer.FindOrOpen(str(samples_path(path)))
    times = samples.GetAttributeAtPath(f"/References.{TRAJECTORY_TIMES}")
    times.default = Vt.DoubleArray([*TRAJECTORY_SECONDS[:-1], 9.0])
    samples.Save()
    assert read_references(path).trajectories is None
    times.default = Vt.DoubleArray(list(TRAJECTORY_SECONDS))
    samples.SetTimeSample("/References.face:reference:trajectory", 3, Vt.Vec3fArray(2))
    samples.Save()
    with pytest.raises(InputError, match=r"trajectory.*time code 3"):
        read_references(path)


@pytest.mark.parametrize("rate", [-24.0, 1e300, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(tmp_path: Path, rate: float) -> None:
    path = write(tmp_path, small_references(tmp_path))
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.GetAttributeAtPath("/References.face:reference:rate").default = rate
    layer.Save()
    with pytest.raises(InputError, match=r"face:reference:rate: frame rate .*; it must be"):
        read_references(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rigid": ("nose",)}, "their rigid markers nose are none of their markers: restore"),
        ({"neutral": np.zeros((0, 3))}, r"their neutral has 0 of \d+ markers: restore"),
        ({"shape_names": (), "weights": np.zeros((5, 0))}, "they have no shapes: restore"),
        ({"motion": NOT_FINITE}, "their motion space holds values that are not finite: restore"),
    ],
)
def test_names_and_arrays_of_other_lengths_are_refused(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = write(tmp_path, replace(small_references(tmp_path), **change))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        read_references(path)


def test_arrays_are_in_a_binary_layer_and_assets_that_hold_them_as_text_are_read(
    tmp_path: Path,
) -> None:
    references = small_references(tmp_path)
    path = write(tmp_path, references)
    text = Sdf.Layer.FindOrOpen(str(path))
    held = [
        text.GetAttributeAtPath(f"/References.{name}")
        for name in ("face:motion:sample", "face:reference:frame")
    ]
    markers = text.GetPrimAtPath("/References/Markers").attributes
    assert held == [None, None]
    assert not {"points", "extent", "face:markers:neutral"} & set(markers.keys())
    samples = tmp_path / "hero.references.samples.usdc"
    assert samples.read_bytes().startswith(b"PXR-USDC")
    # As versions before wrote it: everything in the asset itself.
    binary = Sdf.Layer.FindOrOpen(str(samples))
    for prim in ("/References", "/References/Markers"):
        for attribute in binary.GetPrimAtPath(prim).attributes:
            Sdf.CopySpec(binary, attribute.path, text, attribute.path)
    text.subLayerPaths = [each for each in text.subLayerPaths if "samples" not in each]
    text.Export(str(tmp_path / "old.references.usda"))
    old, new = read_references(tmp_path / "old.references.usda"), read_references(path)
    np.testing.assert_array_equal(old.markers, new.markers)
    np.testing.assert_array_equal(old.neutral, new.neutral)
    np.testing.assert_array_equal(old.motion.sample, new.motion.sample)


def test_a_binary_asset_holds_its_arrays_itself(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    write_rig(tmp_path / "rig.usda", small_rig())
    path = tmp_path / "hero.references.usdc"
    write_references(path, references, read_rig(tmp_path / "rig.usda"), provenance=Provenance())
    assert not (tmp_path / "hero.references.samples.usdc").exists()
    np.testing.assert_allclose(read_references(path).markers, references.markers, rtol=1e-6)


def test_a_viewer_that_scrubs_sees_each_pair_on_the_rig(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    stage = Usd.Stage.Open(str(write(tmp_path, references)))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/References/Rig/rig/skeleton"))
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/References/Rig")), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton).GetAnimQuery()
    assert tuple(query.GetBlendShapeOrder()) == references.shape_names
    for pair, row in enumerate(references.weights):
        np.testing.assert_array_equal(query.ComputeBlendShapeWeights(pair + 1), row)


@pytest.mark.parametrize("reset", [False, True])
def test_a_rig_in_other_units_stands_at_its_size_beside_the_markers(
    tmp_path: Path, reset: bool
) -> None:
    references = small_references(tmp_path)
    write_rig(references.rig_file, small_rig())
    before = read_rig(references.rig_file).meshes[0].points
    rig = Usd.Stage.Open(str(references.rig_file))
    UsdGeom.SetStageMetersPerUnit(rig, 1.0)
    UsdGeom.SetStageUpAxis(rig, "Z")
    top = UsdGeom.Xformable(rig.GetDefaultPrim())
    top.ClearXformOpOrder()
    top.AddScaleOp(opSuffix="small").Set((0.01, 0.01, 0.01))
    top.AddRotateXOp(opSuffix="up").Set(90)
    top.SetResetXformStack(reset)
    rig.Save()
    np.testing.assert_allclose(read_rig(references.rig_file).meshes[0].points, before, atol=1e-4)
    stage = Usd.Stage.Open(str(write(tmp_path, references)))
    mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    world = UsdGeom.XformCache().GetLocalToWorldTransform(mesh)
    shown = [world.Transform(point) for point in UsdGeom.Mesh(mesh).GetPointsAttr().Get()]
    np.testing.assert_allclose(np.array(shown) * 10, before, atol=1e-4)


def test_tuned_pairs_win_and_the_others_still_show_proposals(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    path = write(tmp_path, references)
    tune(tmp_path, references, {1: 0.25, 3: 0.75})
    back = read_references(path)
    np.testing.assert_array_equal(back.tuned, [False, True, False, True, False])
    np.testing.assert_array_equal(back.weights[1], [0.25] * 3)
    np.testing.assert_array_equal(back.weights[[0, 2, 4]], references.weights[[0, 2, 4]])


def test_proposing_again_never_touches_what_was_tuned(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    path = write(tmp_path, references)
    tune(tmp_path, references, {1: 0.25})
    other = small_references(tmp_path, pairs=8, seed=1)
    frames = other.frames.copy()
    frames[1] = references.frames[1]
    write(tmp_path, replace(other, frames=frames))
    back = read_references(path)
    np.testing.assert_array_equal(back.weights[1], [0.25] * 3)
    np.testing.assert_array_equal(back.tuned, np.arange(8) == 1)
    rest = np.arange(8) != 1
    np.testing.assert_array_equal(back.weights[rest], other.weights[rest])


def test_tuning_more_keeps_what_was_tuned_before(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    write(tmp_path, references)
    tune(tmp_path, references, {1: 0.25, 2: 0.5})
    tune(tmp_path, references, {2: 1.0})
    tuned = read_tuned_pairs(tmp_path / "hero.references.tuned.usda")
    assert [(each.pair, each.weights["smile"]) for each in tuned] == [(1, 0.25), (2, 1.0)]


def grown(references: References, more: int) -> References:
    """The same pairs and some more."""
    other = small_references(references.rig_file.parent, more, seed=1)
    return replace(
        references,
        markers=np.concatenate([references.markers, other.markers]),
        weights=np.concatenate([references.weights, other.weights]),
        frames=np.concatenate([references.frames, other.frames]),
        takes=references.takes + other.takes,
        tuned=np.concatenate([references.tuned, np.ones(more, dtype=bool)]),
    )


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("before", [True, False], ids=["over an old one", "where none was"])
def test_wherever_writing_stops_the_asset_is_old_or_new_or_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, before: bool
) -> None:
    old = small_references(tmp_path)
    new = grown(old, 2)
    tuned = [
        TunedPair(pair, new.takes[pair], int(new.frames[pair]), {"smile": 0.5}) for pair in (5, 6)
    ]
    seen = []
    for stop in range(5):
        folder = tmp_path / str(stop)
        folder.mkdir()
        path = folder / "hero.references.usda"
        write_rig(folder / "rig.usda", small_rig())
        if before:
            write(folder, old)
            tune(folder, old, {1: 0.25})
        with monkeypatch.context() as patched, contextlib.suppress(InputError):
            stop_at(patched, call, stop)
            write_references(
                path, new, read_rig(folder / "rig.usda"), tuned=tuned, provenance=Provenance()
            )
        seen.append(state(path, new))
    nothing = "old" if before else "none"
    assert seen[0] == nothing
    assert seen[-1] == "new"
    assert set(seen[1:-1]) == {nothing} if call == "fsync" else {nothing, "refused"}


def stop_at(patched: pytest.MonkeyPatch, call: str, count: int) -> None:
    """Let a call through so often, and no more."""
    owner = os if call == "fsync" else Path
    whole, left = getattr(owner, call), iter(range(count))

    def until(*arguments: object) -> object:
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        return whole(*arguments)

    patched.setattr(owner, call, until)


def state(path: Path, new: References) -> str:
    if not path.exists():
        return "none"
    try:
        back = read_references(path)
    except InputError as error:
        told = str(error)
        assert "has no pair there" in told or "samples hold" in told
        return "refused"
    count = len(back.frames)
    assert list(back.frames) == list(new.frames[:count])
    np.testing.assert_array_equal(back.tuned[5:], True)
    return "new" if count == len(new.frames) else "old"


def test_written_references_pass_every_validator(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    path = write(tmp_path, references)
    tune(tmp_path, references, {1: 0.25})
    assert validate(path) == []


def test_a_take_is_no_references_asset(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    with pytest.raises(InputError, match=r"not a references asset.*usdface select"):
        read_references(tmp_path / "rig.usda")


def test_a_layer_of_references_given_alone_is_refused_with_what_to_give(tmp_path: Path) -> None:
    references = small_references(tmp_path)
    path = write(tmp_path, references)
    tune(tmp_path, references, {1: 0.25})
    with pytest.raises(InputError, match=f"only a layer .* give the asset itself: {path}"):
        read_references(tmp_path / "hero.references.tuned.usda")


def test_a_placement_that_is_no_path_is_refused(tmp_path: Path) -> None:
    placed = replace(small_references(tmp_path), placement=tmp_path / "hero.placement.usda")
    path = write(tmp_path, placed)
    layer = Sdf.Layer.FindOrOpen(str(path))
    del layer.GetPrimAtPath("/References").properties[PLACEMENT]
    prim = layer.GetPrimAtPath("/References")
    names = Sdf.AttributeSpec(prim, PLACEMENT, Sdf.ValueTypeNames.TokenArray)
    names.default = ["a"]
    layer.Save()
    with pytest.raises(InputError, match="no path of a file"):
        read_references(path)


def test_an_end_beyond_the_pairs_is_refused_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, small_references(tmp_path))
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.endTimeCode = 1e9
    layer.Save()
    with pytest.raises(InputError, match=r"says 1000000000 pairs, and .* holds 5"):
        read_references(path)
