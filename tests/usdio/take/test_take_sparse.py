"""Visibility and confidence are written where they change, and read back as USD reads them."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from usdface.core.assets import Event, Markers, Take
from usdface.core.provenance import Provenance
from usdface.usdio.take import write as take_write
from usdface.usdio.take.read import TakeReader, read_take
from usdface.usdio.take.write import write_take


def make_take(visible: np.ndarray, confidence: np.ndarray) -> Take:
    rng = np.random.default_rng(0)
    markers = Markers(
        names=tuple(f"m{i}" for i in range(visible.shape[1])),
        positions=rng.normal(0, 50, (*visible.shape, 3)).astype(np.float32),
        visible=visible,
        confidence=confidence.astype(np.float32),
        neutral_frame=11,
    )
    return Take("talk", Fraction(120), 11, markers=markers)


@pytest.mark.parametrize("lot", [3, 7, 1000])
def test_what_is_written_where_it_changes_reads_back_at_every_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lot: int
) -> None:
    rng = np.random.default_rng(0)
    visible = rng.random((40, 5)) > 0.02
    visible[15:30] = True
    confidence = np.where(visible, 1.0, rng.random((40, 5)))
    monkeypatch.setattr(take_write, "FRAMES_IN_MEMORY", lot)
    write_take(tmp_path / "talk.take.usda", make_take(visible, confidence), provenance=Provenance())
    for first, last in ((11, 50), (24, 31), (20, 20)):
        markers = read_take(tmp_path / "talk.take.usda", first=first, last=last).markers
        assert markers is not None
        rows = slice(first - 11, last - 10)
        np.testing.assert_array_equal(markers.visible, visible[rows])
        np.testing.assert_array_equal(markers.confidence, confidence[rows].astype(np.float32))


def test_frames_picked_from_a_take_are_those_of_the_whole(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    visible = rng.random((40, 5)) > 0.2
    path = tmp_path / "talk.take.usda"
    write_take(path, make_take(visible, rng.random((40, 5))), provenance=Provenance())
    samples = Sdf.Layer.FindOrOpen(str(tmp_path / "talk.take.samples.usdc"))
    for name in ("visible", "confidence"):  # as others thin them: between samples, and before all
        root = samples.rootPrims[0].path
        attribute = samples.GetAttributeAtPath(f"{root}/Markers.primvars:face:{name}")
        gone = {11.0, 12.0, 20.0, 21.0, 22.0, 35.0, 50.0}
        for time in gone & set(samples.ListTimeSamplesForPath(attribute.path)):
            samples.EraseTimeSample(attribute.path, time)
    samples.Save()
    reader = TakeReader(path)
    whole = reader.read().markers
    assert whole is not None
    for frames in ([11], [11, 12, 22], [21, 36, 49, 50], sorted(rng.permutation(40)[:9] + 11)):
        picked = reader.read_markers_at(list(map(int, frames)))
        assert picked is not None
        rows = np.array(frames) - 11
        np.testing.assert_array_equal(picked.positions, whole.positions[rows])
        np.testing.assert_array_equal(picked.visible, whole.visible[rows])
        np.testing.assert_array_equal(picked.confidence, whole.confidence[rows])


def test_usd_itself_sees_the_same_at_every_frame_and_between(tmp_path: Path) -> None:
    visible = np.ones((12, 2), bool)
    visible[5:8, 1] = False
    write_take(tmp_path / "talk.take.usda", make_take(visible, visible), provenance=Provenance())
    stage = Usd.Stage.Open(str(tmp_path / "talk.take.usda"))
    prim = stage.GetPrimAtPath(stage.GetDefaultPrim().GetPath().AppendChild("Markers"))
    confidence = prim.GetAttribute("primvars:face:confidence")
    assert len(confidence.GetTimeSamples()) == 5  # the first, and both sides of each change
    for frame in range(12):
        np.testing.assert_array_equal(np.asarray(confidence.Get(11 + frame)), visible[frame])
        seen = prim.GetAttribute("primvars:face:visible").Get(11 + frame)
        np.testing.assert_array_equal(np.asarray(seen), visible[frame])
    assert confidence.Get(13.5)[1] == 1.0


@pytest.mark.parametrize(
    ("rate", "offset", "frame", "timecode"),
    [
        (120, 1000, 1011, "10:00:00:28"),
        (30, 0, 3, "10:00:00:28"),
        (24, 0, 2, ""),
        (240, 5, 27, "10:00:00:28"),
    ],
)
def test_the_neutral_frame_and_timecode_move_with_the_samples(
    tmp_path: Path, rate: int, offset: int, frame: int, timecode: str
) -> None:
    """In stages that begin there, the last label of a second at 30; 24 has none of that number."""
    seen = np.ones((12, 2), bool)
    take = replace(make_take(seen, seen), timecode_start="10:00:00:28")
    write_take(tmp_path / "talk.take.usda", take, provenance=Provenance())
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.timeCodesPerSecond = rate
    shot.subLayerPaths, shot.defaultPrim = ["talk.take.usda"], "Take"
    shot.subLayerOffsets[0] = Sdf.LayerOffset(offset)
    shot.startTimeCode = shot.endTimeCode = frame
    shot.Save()
    reader = TakeReader(tmp_path / "shot.usda")
    assert reader.neutral_frame == frame
    assert reader.timecode_at(frame) == timecode
    assert reader.timecode_at(frame + rate // 10) == (timecode and "10:00:01:01")


def test_events_keep_their_place_under_a_layer_offset(tmp_path: Path) -> None:
    seen = np.ones((12, 2), bool)
    take = replace(make_take(seen, seen), events=(Event("Clap", 13.0), Event("Slate", 17.5)))
    write_take(tmp_path / "talk.take.usda", take, provenance=Provenance())
    assert read_take(tmp_path / "talk.take.usda").events == take.events
    assert read_take(tmp_path / "talk.take.usda", first=14, last=22).events == take.events[1:]
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.timeCodesPerSecond = 120
    shot.subLayerPaths = ["talk.take.usda"]
    shot.subLayerOffsets[0] = Sdf.LayerOffset(1000)
    shot.Save()
    stage = Usd.Stage.Open(shot)
    root = stage.GetPrimAtPath("/Take")
    times = [time.GetValue() for time in root.GetAttribute("face:events:times").Get()]
    assert times == [1013.0, 1017.5]


@pytest.mark.parametrize("rate", [24, 30, 60000 / 1001, 240])
def test_confidence_at_another_rate_is_interpolated_as_by_usd(tmp_path: Path, rate: float) -> None:
    rng = np.random.default_rng(0)
    confidence = rng.random((40, 5))
    write_take(
        tmp_path / "talk.take.usda", make_take(confidence > 0, confidence), provenance=Provenance()
    )
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.timeCodesPerSecond = rate
    shot.subLayerPaths, shot.defaultPrim = ["talk.take.usda"], "Take"
    shot.startTimeCode, shot.endTimeCode = 3, 9
    shot.Save()
    markers = read_take(tmp_path / "shot.usda").markers
    assert markers is not None
    stage = Usd.Stage.Open(shot)
    attribute = stage.GetAttributeAtPath("/Take/Markers.primvars:face:confidence")
    expected = [attribute.Get(frame) for frame in range(3, 10)]
    np.testing.assert_allclose(markers.confidence, expected, rtol=1e-6)
