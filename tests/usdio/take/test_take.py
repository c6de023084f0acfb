"""Takes survive the way to disk and back; foreign files become takes."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from usdface.core.assets import Markers, Take, Video, WeightsClip
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.usdio.layers import read_provenance
from usdface.usdio.take.foreign import read_foreign_take
from usdface.usdio.take.read import TakeReader, read_take
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate


def small_take(frames: int = 12, rate: Fraction = Fraction(120)) -> Take:
    rng = np.random.default_rng(0)
    visible = rng.random((frames, 4)) > 0.2
    markers = Markers(
        names=("brow", "lip", "head_1", "head_2"),
        positions=rng.normal(0, 80, (frames, 4, 3)).astype(np.float32),
        visible=visible,
        confidence=visible.astype(np.float32),
        rigid=("head_1", "head_2"),
        neutral_frame=103,
    )
    motion = np.tile(np.eye(4), (frames, 1, 1))
    motion[:, :3, 3] = rng.normal(0, 100, (frames, 3))
    return Take(
        name="kitchen",
        rate=rate,
        first_frame=101,
        markers=markers,
        source=WeightsClip(("a", "b"), rng.random((frames, 2)).astype(np.float32), 101, rate),
        head_motion=motion,
        video=Video(Path("kitchen.mov"), Fraction(24), -0.4, 12.5),
        performer="Ada",
        emotion="anger",
        timecode_start="01:00:00:00",
    )


@pytest.mark.parametrize("name", ["x.take.usda", "x.take.usdc"])
def test_written_take_reads_back_the_same(tmp_path: Path, name: str) -> None:
    take = small_take()
    write_take(tmp_path / name, take, provenance=Provenance())
    back = read_take(tmp_path / name)
    assert back.markers is not None
    assert take.markers is not None
    np.testing.assert_allclose(back.markers.positions, take.markers.positions, rtol=1e-6)
    np.testing.assert_array_equal(back.markers.visible, take.markers.visible)
    np.testing.assert_array_equal(back.markers.confidence, take.markers.confidence)
    np.testing.assert_allclose(back.head_motion, take.head_motion, atol=1e-6)
    assert back.source is not None
    np.testing.assert_array_equal(back.source.values, take.source.values)
    for field in ("names", "rigid", "neutral_frame", "space"):
        assert getattr(back.markers, field) == getattr(take.markers, field)
    for field in ("name", "rate", "first_frame", "performer", "emotion", "timecode_start"):
        assert getattr(back, field) == getattr(take, field)
    assert (back.video.rate, back.video.offset, back.video.drift) == (24, -0.4, 12.5)
    assert back.video.file == Path("kitchen.mov").resolve()


def test_written_take_passes_every_validator(tmp_path: Path) -> None:
    (tmp_path / "kitchen.mov").touch()
    take = replace(small_take(), video=Video(tmp_path / "kitchen.mov"))
    write_take(tmp_path / "x.take.usda", take, provenance=Provenance())
    assert validate(tmp_path / "x.take.usda") == []


def test_a_range_of_frames_is_that_part_of_the_whole(tmp_path: Path) -> None:
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())
    reader = TakeReader(tmp_path / "x.take.usda")
    whole, part = reader.read(), reader.read(104, 107)
    assert part.first_frame == 104
    np.testing.assert_array_equal(part.markers.positions, whole.markers.positions[3:7])
    np.testing.assert_array_equal(part.head_motion, whole.head_motion[3:7])
    with pytest.raises(InputError, match=r"frames 90-95 are not all there; it has 101-112"):
        reader.read(90, 95)


def test_cleaned_take_lies_over_the_raw_one_and_leaves_it(tmp_path: Path) -> None:
    raw, cleaned = tmp_path / "x.take.usda", tmp_path / "x.clean.take.usda"
    take = small_take()
    write_take(raw, take, provenance=Provenance())
    before = raw.read_bytes()
    still = replace(take.markers, positions=take.markers.positions * 0.5, space="stabilized")
    write_take(
        cleaned, Take("kitchen", take.rate, 101, markers=still), over=raw, provenance=Provenance()
    )
    back = read_take(cleaned)
    assert back.markers.space == "stabilized"
    np.testing.assert_allclose(back.markers.positions, take.markers.positions * 0.5, rtol=1e-6)
    assert back.performer == "Ada", "what cleaning does not say must show through"
    assert raw.read_bytes() == before


@pytest.mark.parametrize("rate", ["23.976", "24", "25", "29.97", "59.94", "60", "119.88", "120"])
def test_rates_stay_exact(tmp_path: Path, rate: str) -> None:
    exact = Fraction(round(float(rate) * 1.001) * 1000, 1001) if "." in rate else Fraction(rate)
    write_take(
        tmp_path / "x.take.usda",
        replace(small_take(rate=exact), source=None),
        provenance=Provenance(),
    )
    assert TakeReader(tmp_path / "x.take.usda").rate == exact


def test_provenance_travels_in_the_layer(tmp_path: Path) -> None:
    made = Provenance("ingest", '{"a":1}', {"sub/häuser 1.c3d": "00ff"})
    write_take(tmp_path / "x.take.usdc", small_take(), provenance=made)
    assert read_provenance(tmp_path / "x.take.usdc") == made


def test_samples_are_not_replaced_where_the_layer_to_open_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "x.take.usda"
    write_take(path, small_take(), provenance=Provenance())
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    with pytest.raises(InputError, match="another process is writing it"), replacing(path):
        write_take(path, small_take(frames=5), provenance=Provenance())
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == before
    assert read_take(path).frame_count == 12


def test_failed_writing_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "x.take.usda"
    write_take(path, small_take(), provenance=Provenance())
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    broken = replace(small_take(), name=object())  # no string: USD refuses it in the last layer
    with pytest.raises(Exception, match=r"name|type|string"):
        write_take(path, broken, provenance=Provenance())
    after = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    assert after == before


def foreign_stage(path: Path, *, rate: float = 60, up: str = "Y", metres: float = 0.001):
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    return stage


POSITIONS = np.random.default_rng(3).normal(0, 50, (6, 5, 3)).astype(np.float32)


@pytest.mark.parametrize("how", ["listed", "indexed", "sampled"])
def test_points_with_names_in_a_primvar_become_markers(tmp_path: Path, how: str) -> None:
    stage = foreign_stage(tmp_path / "points.usda")
    points = UsdGeom.Points.Define(stage, "/mocap/face")
    labels = UsdGeom.PrimvarsAPI(points).CreatePrimvar(
        "names", Sdf.ValueTypeNames.StringArray, UsdGeom.Tokens.vertex
    )
    if how == "indexed":
        labels.Set(list("edcba"))
        labels.SetIndices([4, 3, 2, 1, 0])
    else:
        labels.Set(list("abcde"), 10 if how == "sampled" else Usd.TimeCode.Default())
    for frame, row in enumerate(POSITIONS):
        if frame != 3:  # a frame the file lacks is a gap
            points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(row), 10 + frame)
    stage.Save()
    found = read_foreign_take(tmp_path / "points.usda")
    assert found.names == tuple("abcde")
    assert (found.first_frame, found.rate) == (10, 60)
    seen = np.arange(6) != 3
    np.testing.assert_array_equal(found.visible.all(axis=1), seen)
    np.testing.assert_allclose(found.positions[seen], POSITIONS[seen], rtol=1e-6)


@pytest.mark.parametrize("decimals", [3, 15])
def test_gaps_beside_samples_at_no_whole_time_codes_hide_nothing_else(
    tmp_path: Path, decimals: int
) -> None:
    """As of a capture at 59.94 Hz in a stage of 24, in full or rounded by a tool."""
    rng = np.random.default_rng(0)
    rows = rng.normal(0, 50, (2000, 5, 3)).astype(np.float32)
    rows[rng.random((2000, 5)) < 0.1] = (np.nan, np.inf, 0)
    stage = foreign_stage(tmp_path / "points.usda", rate=24)
    points = UsdGeom.Points.Define(stage, "/mocap/face").CreatePointsAttr()
    for time, row in zip(np.round(np.arange(2000) * 24.024 / 60, decimals), rows, strict=True):
        points.Set(Vt.Vec3fArray.FromNumpy(row), float(time))
    stage.Save()
    found = read_foreign_take(tmp_path / "points.usda")
    assert found.rate == Fraction(60000, 1001)
    np.testing.assert_array_equal(found.visible, np.isfinite(rows).all(axis=2))


def test_skeleton_joints_become_markers_in_our_space(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "joints.usda", up="Z", metres=0.01)
    UsdSkel.Root.Define(stage, "/mocap")
    skeleton = UsdSkel.Skeleton.Define(stage, "/mocap/skeleton")
    joints = ["root", *(f"root/{name}" for name in "abcde")]
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)] * 6)
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)] * 6)
    animation = UsdSkel.Animation.Define(stage, "/mocap/skeleton/animation")
    animation.CreateJointsAttr(joints)
    animation.CreateRotationsAttr([Gf.Quatf(1)] * 6)
    animation.CreateScalesAttr([Gf.Vec3h(1)] * 6)
    for frame, row in enumerate(POSITIONS):
        moved = np.concatenate([[[1, 2, 3]], row]).astype(np.float32)
        animation.CreateTranslationsAttr().Set(Vt.Vec3fArray.FromNumpy(moved), frame)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    stage.Save()
    found = read_foreign_take(tmp_path / "joints.usda")
    assert found.names == tuple("abcde")
    x, y, z = np.moveaxis(POSITIONS + np.float32([1, 2, 3]), -1, 0)
    np.testing.assert_allclose(
        found.positions, 10 * np.stack([x, z, -y], axis=-1), rtol=1e-4, atol=1e-3
    )


def test_xforms_become_markers_at_half_the_time_codes(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "xforms.usda", rate=24)
    UsdGeom.Xform.Define(stage, "/mocap")
    for marker, name in enumerate("abcde"):
        op = UsdGeom.Xform.Define(stage, f"/mocap/{name}").AddTranslateOp()
        for frame, row in enumerate(POSITIONS):
            op.Set(Gf.Vec3d(*map(float, row[marker])), 0.5 * frame)
    stage.Save()
    found = read_foreign_take(tmp_path / "xforms.usda")
    assert found.rate == 48
    np.testing.assert_allclose(found.positions, POSITIONS, rtol=1e-6)


def test_hidden_or_unsampled_xforms_are_gaps(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "xforms.usda")
    UsdGeom.Xform.Define(stage, "/mocap")
    for marker, name in enumerate("abcde"):
        xform = UsdGeom.Xform.Define(stage, f"/mocap/{name}")
        op, constant = xform.AddTranslateOp(), name == "e"
        for frame, row in enumerate(POSITIONS[:1] if constant else POSITIONS):
            if (name, frame) != ("b", 3):
                op.Set(Gf.Vec3d(*map(float, row[marker])), frame)
    hidden = UsdGeom.Imageable(stage.GetPrimAtPath("/mocap/a")).CreateVisibilityAttr()
    for frame, shown in ((0, "inherited"), (4, "invisible"), (5, "inherited")):
        hidden.Set(shown, frame)
    stage.Save()
    found = read_foreign_take(tmp_path / "xforms.usda")
    assert np.argwhere(~found.visible).tolist() == [[3, 1], [4, 0]]


def test_points_that_come_and_go_are_known_by_their_ids(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "points.usda")
    points = UsdGeom.Points.Define(stage, "/mocap/face")
    rng = np.random.default_rng(0)
    for frame, row in enumerate(POSITIONS):
        order = rng.permutation(5)[: 5 - frame % 2]
        points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(row[order]), frame)
        points.GetIdsAttr().Set((order + 7).tolist(), frame)
    stage.Save()
    found = read_foreign_take(tmp_path / "points.usda")
    columns = [int(name[-3:]) - 7 for name in found.names]
    assert found.visible.sum(axis=1).tolist() == [5, 4] * 3
    expected = POSITIONS[:, columns]
    np.testing.assert_allclose(found.positions[found.visible], expected[found.visible], rtol=1e-6)


def test_two_sets_of_markers_must_be_told_apart(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "two.usda")
    for name in ("face", "body"):
        points = UsdGeom.Points.Define(stage, f"/{name}")
        for frame, row in enumerate(POSITIONS):
            points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(row), frame)
    stage.Save()
    with pytest.raises(InputError, match=r"2 sets of markers.*name one with --prim"):
        read_foreign_take(tmp_path / "two.usda")
    assert len(read_foreign_take(tmp_path / "two.usda", prim="/body").names) == 5


def test_edits_of_a_performance_are_not_lost_without_a_word(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "edited.usda")
    animation = UsdSkel.Animation.Define(stage, "/Hero/FaceSolve")
    animation.CreateBlendShapesAttr(["jawOpen"])
    for frame in range(4):
        animation.CreateBlendShapeWeightsAttr().Set([0.1 * frame], frame)
    stage.Save()
    assert read_foreign_take(tmp_path / "edited.usda").source.names == ("jawOpen",)
    edit = animation.GetPrim().CreateAttribute("face:edit:jawOpen", Sdf.ValueTypeNames.Float)
    edit.Set(0.2, 1)
    stage.Save()
    with pytest.raises(InputError, match=r"</Hero/FaceSolve>: has edits, .*`usdface bake`"):
        read_foreign_take(tmp_path / "edited.usda")


def spoil_rate(layer: Sdf.Layer) -> None:
    layer.timeCodesPerSecond = 0


def spoil_names(layer: Sdf.Layer) -> None:
    layer.GetAttributeAtPath("/Take/Markers.face:markers:names").default = ["one"]


def spoil_nan(layer: Sdf.Layer) -> None:
    bad = np.zeros((4, 3), np.float32)
    bad[2] = np.nan
    layer.SetTimeSample("/Take/Markers.points", 105, Vt.Vec3fArray.FromNumpy(bad))


def spoil_weights(layer: Sdf.Layer) -> None:
    layer.SetTimeSample("/Take/Source.blendShapeWeights", 105, Vt.FloatArray([0.5, np.nan]))


def spoil_schema(layer: Sdf.Layer) -> None:
    layer.customLayerData = {"usdface": {"schema": 99}}


def spoil_api(layer: Sdf.Layer) -> None:
    layer.GetPrimAtPath("/Take").ClearInfo("apiSchemas")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_rate, r"timeCodesPerSecond is 0; a take needs a rate above 0"),
        (spoil_names, r"points> time code 101: 4 values for 1 name"),
        (spoil_nan, r"points> time code 105: .* is \[nan nan nan\], not finite"),
        (spoil_weights, r"Weights> time code 105: .* is nan, not finite"),
        (spoil_schema, r"written with usdface schema 99, this version knows 1; update usdface"),
        (spoil_api, r"no FaceTakeAPI; make one from it with `usdface ingest`"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_spoiled_take_is_refused_with_the_place_named(tmp_path, spoil, message) -> None:
    write_take(tmp_path / "x.take.usdc", small_take(), provenance=Provenance())
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "x.take.usdc"))
    spoil(layer)
    layer.Save()
    with pytest.raises(InputError, match=message):
        read_take(tmp_path / "x.take.usdc")


@pytest.mark.parametrize("content", [b"", b"#usda 1.0\n(", b"PXR-USDC" + bytes(40), b"\x00" * 99])
def test_a_file_that_is_no_usd_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.usda").write_bytes(content)
    with pytest.raises(InputError, match=r"x\.usda"):
        read_take(tmp_path / "x.usda")


def test_a_take_whose_samples_are_gone_says_which(tmp_path: Path) -> None:
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())
    (tmp_path / "links").mkdir()
    link = tmp_path / "links" / "x.take.usda"
    link.symlink_to(tmp_path / "x.take.usda")
    with pytest.raises(InputError, match=r"cannot be read; put it back .* symbolic link"):
        read_take(link)
    (tmp_path / "x.take.samples.usdc").unlink()
    with pytest.raises(InputError, match=r"its sublayer \./x\.take\.samples\.usdc cannot be read"):
        read_take(tmp_path / "x.take.usda")


def test_two_samples_of_one_frame_are_refused_and_none_is_lost(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "near.usda")
    points = UsdGeom.Points.Define(stage, "/mocap/face").GetPointsAttr()
    for time, row in zip((1, 1.2, 2, 3, 4, 5), POSITIONS, strict=True):
        points.Set(Vt.Vec3fArray.FromNumpy(row), time)
    stage.Save()
    with pytest.raises(InputError, match="not evenly spaced"):
        read_foreign_take(tmp_path / "near.usda")


def test_weights_of_two_characters_must_be_chosen_between(tmp_path: Path) -> None:
    stage = foreign_stage(tmp_path / "two.usda")
    for number, name in enumerate(("kim", "lee")):
        animation = UsdSkel.Animation.Define(stage, f"/{name}/weights")
        animation.CreateBlendShapesAttr(["smile"])
        for frame in range(3):
            animation.CreateBlendShapeWeightsAttr().Set([float(number)], frame)
    stage.Save()
    with pytest.raises(InputError, match="2 animations with blendShapeWeights: </kim/weights>, "):
        read_foreign_take(tmp_path / "two.usda")
    found = read_foreign_take(tmp_path / "two.usda", prim="/lee")
    np.testing.assert_array_equal(found.source.values, 1)
