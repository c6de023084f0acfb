"""Numbers in a file that would have a reader count for hours: refused at once, by name."""

import resource
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.edited_weights import read_weights
from tests.usdio.performance.test_edits import author, perform
from tests.usdio.small_creature import creature_acts
from tests.usdio.small_rig import small_rig
from tests.usdio.take.test_take import small_take
from usdface.core.controls import EmotionalSequence, SequenceMatch
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rates import FRAMES_BETWEEN_KEYS, UNSAMPLED_FRAMES, check_frame_span
from usdface.steps.edits.edit import all_frames
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.layers import open_stage, read_provenance
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.referenced_files import frame_range_of
from usdface.usdio.retarget.sequences import (
    read_matches,
    read_sequence,
    write_matches,
    write_sequence,
)
from usdface.usdio.rig.mesh import read_face_mesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.foreign import read_foreign_take
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

ROOM = 2 << 30
"""What a test may ask for beyond what it has [bytes]: a reader that believes a number asks more."""


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


pytestmark = pytest.mark.skipif(
    not Path("/proc/self/statm").is_file(), reason="memory in use is read from /proc"
)


def change(path: Path, how: Callable[[Sdf.Layer], None]) -> None:
    layer = Sdf.Layer.FindOrOpen(str(path))
    how(layer)
    layer.Save()


def set_end(end: float) -> Callable[[Sdf.Layer], None]:
    def how(layer: Sdf.Layer) -> None:
        layer.endTimeCode = end

    return how


def stray_sample(path: str, time: float) -> Callable[[Sdf.Layer], None]:
    def how(layer: Sdf.Layer) -> None:
        first = layer.ListTimeSamplesForPath(path)[0]
        layer.SetTimeSample(path, time, layer.QueryTimeSample(path, first))

    return how


STRAY = (9e6, 1e9, 1e18, -1e18)


@pytest.mark.parametrize("end", [3e5, 9e6, 1e9, 1e18])
def test_a_takes_end_that_its_samples_do_not_bear_out(tmp_path: Path, end: float) -> None:
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())
    change(tmp_path / "x.take.usda", set_end(end))
    with pytest.raises(InputError, match=r"x\.take\.usda: startTimeCode to endTimeCode"):
        read_take(tmp_path / "x.take.usda")


@pytest.mark.parametrize("time", STRAY)
def test_a_weight_that_lies_far_off_the_others(tmp_path: Path, time: float) -> None:
    path = perform(tmp_path)
    weights = tmp_path / "shot.hero.weights.usdc"
    change(weights, stray_sample("/Hero/FaceSolve.blendShapeWeights", time))
    for read in (read_performance, read_weights):
        with pytest.raises(InputError, match=r"shot\.hero\.usda .*blendShapeWeights"):
            read(path)


def test_keys_that_a_person_sets_may_be_far_apart(tmp_path: Path) -> None:
    path = perform(tmp_path)
    weights = tmp_path / "shot.hero.weights.usdc"
    change(weights, stray_sample("/Hero/FaceSolve.blendShapeWeights", 5000.0))
    assert len(PerformanceReader(path).edited()) == 4900


@pytest.mark.parametrize("time", STRAY)
def test_an_edit_that_lies_far_off_the_performance(tmp_path: Path, time: float) -> None:
    path = perform(tmp_path)
    author(path, face__edit__smile={101: 0.1, time: 0.2})
    with pytest.raises(InputError, match="edits"):
        all_frames(PerformanceReader(path))


def foreign_points(path: Path, times: list[float]) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    points = UsdGeom.Points.Define(stage, "/markers").GetPointsAttr()
    for time in times:
        points.Set(Vt.Vec3fArray(5), time)
    stage.Save()


@pytest.mark.parametrize(
    "times",
    [[0, 1, 2, 3, time] for time in STRAY]
    + [[0, 1e-300, 2e-300, 1], [-1e308, 0, 1e308], [0, 1e300], [1e300, 2e300, 3e300]],
    ids=str,
)
def test_a_foreign_sample_that_lies_far_off_the_others(tmp_path: Path, times: list[float]) -> None:
    foreign_points(tmp_path / "m.usda", times)
    with pytest.raises(InputError, match=r"m\.usda"):
        read_foreign_take(tmp_path / "m.usda")


def small_sequence() -> EmotionalSequence:
    target = creature_acts(np.zeros((5, 3)))
    return EmotionalSequence("joy", ("a", "b"), np.zeros((5, 2)), target, np.ones(5))


@pytest.mark.parametrize("time", STRAY)
@pytest.mark.parametrize("side", ["Source", "Target"])
def test_a_sequences_key_that_lies_far_off_the_others(
    tmp_path: Path, time: float, side: str
) -> None:
    path = tmp_path / "joy.sequence.usda"
    write_sequence(path, small_sequence(), rate=Fraction(24), provenance=Provenance())
    assert len(read_sequence(path).source) == 5
    change(path, stray_sample(f"/Sequence/{side}.blendShapeWeights", time))
    with pytest.raises(InputError, match=rf"joy\.sequence\.usda </Sequence/{side}>"):
        read_sequence(path)


@pytest.mark.parametrize(
    ("name", "kind", "value"),
    [
        ("lastFrame", Sdf.ValueTypeNames.Int, -(2**31)),
        ("lastFrame", Sdf.ValueTypeNames.Int, 10),  # one frame, to which no sequence is fitted
        ("sequence", Sdf.ValueTypeNames.String, "text"),
        ("firstFrame", Sdf.ValueTypeNames.Token, "soon"),
    ],
)
def test_a_match_that_is_none(tmp_path: Path, name: str, kind: object, value: object) -> None:
    path = tmp_path / "x.matches.usda"
    write_matches(
        path,
        (SequenceMatch(tmp_path / "joy.sequence.usda", "joy", 10, 20, 0.1),),
        rate=Fraction(24),
        provenance=Provenance(),
    )

    def how(layer: Sdf.Layer) -> None:
        prim = layer.GetPrimAtPath("/Matches/match_001")
        prim.RemoveProperty(prim.attributes[f"face:match:{name}"])
        Sdf.AttributeSpec(prim, f"face:match:{name}", kind).default = value

    change(path, how)
    with pytest.raises(InputError, match=r"x\.matches\.usda"):
        read_matches(path, rate=Fraction(24))


@pytest.mark.parametrize("unit", [0.0, -0.01, float("nan"), float("inf"), 1e300])
def test_a_unit_that_is_no_length(tmp_path: Path, unit: float) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())
    for name, read in (("rig.usda", read_rig), ("x.take.usda", read_take)):
        change(tmp_path / name, lambda layer: layer.pseudoRoot.SetInfo("metersPerUnit", unit))
        with pytest.raises(InputError, match=rf"{name}: metersPerUnit is"):
            read(tmp_path / name)


def test_faces_with_fewer_than_no_corners(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "m.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.GetPointsAttr().Set(Vt.Vec3fArray(4))
    mesh.GetFaceVertexCountsAttr().Set([5, -1])
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3])
    stage.Save()
    with pytest.raises(InputError, match="faces name points that are not there"):
        read_face_mesh(tmp_path / "m.usda")
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            count = len(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get())
            UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Set([count + 1, -1])
    stage.Save()
    with pytest.raises(InputError, match="faces name points that are not there"):
        read_rig(tmp_path / "rig.usda")


@pytest.mark.parametrize("end", [1e18, float("inf"), float("nan")])
def test_a_range_to_be_cut_into_tasks_that_is_none(tmp_path: Path, end: float) -> None:
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())
    change(tmp_path / "x.take.usda", set_end(end))
    with pytest.raises(InputError, match=r"x\.take\.usda: startTimeCode to endTimeCode"):
        frame_range_of(tmp_path / "x.take.usda")


@pytest.mark.parametrize(
    "said", ["text", 3, {"version": "1", "inputs": 3}, {"version": "1", "inputs": "text"}], ids=str
)
def test_what_others_keep_under_our_name_is_let_be(tmp_path: Path, said: object) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "x.usda"))
    stage.GetRootLayer().customLayerData = {"usdface": said}
    UsdSkel.Root.Define(stage, "/root")
    stage.Save()
    assert open_stage(tmp_path / "x.usda").GetPrimAtPath("/root")
    made = read_provenance(tmp_path / "x.usda")
    assert made is None or made.inputs == {}


def test_a_span_may_be_as_long_as_its_samples_bear_out() -> None:
    check_frame_span("x", 1, UNSAMPLED_FRAMES, samples=2)
    check_frame_span("x", 1, 432_000, samples=432_000)
    check_frame_span("x", 1, FRAMES_BETWEEN_KEYS * 5000, samples=5000)
    check_frame_span("x", 1, 432_000, samples=None)
    with pytest.raises(InputError, match=r"x: 2 samples on 100001 frames"):
        check_frame_span("x", 1, UNSAMPLED_FRAMES + 1, samples=2)


@pytest.mark.parametrize(
    ("name", "value"), [("drift", -1e6), ("drift", float("nan")), ("offset", float("inf"))]
)
def test_a_video_that_would_stand_still_or_be_nowhere(
    tmp_path: Path, name: str, value: float
) -> None:
    write_take(tmp_path / "x.take.usda", small_take(), provenance=Provenance())

    def how(layer: Sdf.Layer) -> None:
        layer.GetAttributeAtPath(f"/Take.face:video:{name}").default = value

    change(tmp_path / "x.take.usda", how)
    with pytest.raises(InputError, match=r"face:video:offset .* are no place in time"):
        read_take(tmp_path / "x.take.usda")


@pytest.mark.parametrize("frame", ["1e300", "-1e18", "9" * 30])
def test_a_row_of_weights_at_a_frame_that_is_none(tmp_path: Path, frame: str) -> None:
    (tmp_path / "keys.csv").write_text(f"frame,jawOpen\n1,0.5\n{frame},0.2\n")
    with pytest.raises(
        InputError, match=r"keys\.csv line 3: frame number .* must be a whole number"
    ):
        read_weight_table(tmp_path / "keys.csv")
