"""The picture beside the face is the one the camera took of it, and what is missing is said."""

import io
import wave
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.media.bar_code import draw_number, read_number, write_numbered
from tests.tuning.small_asset import small_references, write_asset
from tests.usdio.take.test_take import small_take
from usdface.core.assets import References, Video
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.media.picture.image import write_image
from usdface.tuning.pictures import PairPictures
from usdface.usdio.references.read import PairNotes, read_pair_notes, take_files
from usdface.usdio.take.write import write_take

RATE = Fraction(24)
OFFSET, DRIFT = -0.51, 40.0  # no pair on the edge between two frames
FRAMES = np.array([101, 118, 119, 160, 240])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("take")
    write_numbered(made / "kitchen.mov", list(range(60)), base=1 / RATE, rate=RATE)
    video = Video(made / "kitchen.mov", RATE, OFFSET, DRIFT)
    write_take(
        made / "kitchen.take.usda", replace(small_take(), video=video), provenance=Provenance()
    )
    return made


def references(folder: Path) -> References:
    return replace(small_references(folder), frames=FRAMES)


def pictures(folder: Path, **changes: object) -> PairPictures:
    notes = [PairNotes()] * 5
    given = {"notes": notes, "takes": [folder / "kitchen.take.usda"]} | changes
    return PairPictures(references(folder), given["notes"], given["takes"])  # type: ignore[arg-type]


def decoded(data: bytes) -> np.ndarray:
    with av.open(io.BytesIO(data)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def test_each_pair_shows_the_video_frame_of_its_moment(folder: Path) -> None:
    shown = pictures(folder)
    for pair in (0, 4, 2, 1, 3, 0):
        seconds = ((FRAMES[pair] - 101) / 120 - OFFSET) / (1 + DRIFT * 1e-6)
        assert read_number(decoded(shown.jpeg(pair))) == int(seconds * 24 + 1e-9)
    shown.close()


def test_the_second_before_and_after_is_shown_too(folder: Path) -> None:
    shown = pictures(folder)
    for after in (0.5, -0.25, 0.0):
        seconds = ((FRAMES[2] - 101) / 120 + after - OFFSET) / (1 + DRIFT * 1e-6)
        assert read_number(decoded(shown.jpeg(2, after))) == int(seconds * 24 + 1e-9)
    with pytest.raises(InputError, match=r"does not show frame \d+ -1000\.00 s"):
        shown.jpeg(2, -1000.0)
    shown.close()


def test_a_moment_the_camera_did_not_record_is_said(folder: Path) -> None:
    shown = PairPictures(
        replace(references(folder), frames=FRAMES + 2000),
        [PairNotes()] * 5,
        [folder / "kitchen.take.usda"],
    )
    with pytest.raises(InputError, match="the video of kitchen does not show frame 2101"):
        shown.jpeg(0)
    shown.close()


def test_a_picture_that_the_asset_names_goes_before_the_video(folder: Path) -> None:
    write_image(folder / "pair.png", draw_number(777))
    notes = [PairNotes(image=folder / "pair.png"), *[PairNotes()] * 4]
    shown = pictures(folder, notes=notes)
    assert read_number(decoded(shown.jpeg(0))) == 777
    assert read_number(decoded(shown.jpeg(1))) != 777
    shown.close()


@pytest.mark.parametrize(
    ("video", "message"),
    [
        (None, "the take kitchen has no video"),
        (Video(Path("gone.mov"), RATE), "gone.mov: no such file"),
    ],
    ids=["none", "gone"],
)
def test_what_is_missing_is_named(tmp_path: Path, video: Video | None, message: str) -> None:
    write_take(
        tmp_path / "kitchen.take.usda", replace(small_take(), video=video), provenance=Provenance()
    )
    with pytest.raises(InputError, match=message):
        pictures(tmp_path).jpeg(0)


def test_a_take_that_moved_is_asked_for_by_name(tmp_path: Path) -> None:
    gone = pictures(tmp_path)
    assert gone.reason_without(0)
    with pytest.raises(InputError, match=r"kitchen"):
        gone.jpeg(0)
    nowhere = pictures(tmp_path, takes=[])
    assert nowhere.reason_without(0) == (
        "the take kitchen was not found; name its file with --takes"
    )


def test_an_asset_made_by_hand_knows_no_takes_and_has_no_notes(tmp_path: Path) -> None:
    path = write_asset(tmp_path)
    assert take_files(path) == ()
    notes = read_pair_notes(path)
    assert [(each.viseme, each.emotion, each.image) for each in notes] == [("", "", None)] * 5


@pytest.mark.parametrize("spec", ['{"takes":5,"performances":{}}', '{"takes":null}', "[" * 5000])
def test_takes_of_a_strange_provenance_are_none(tmp_path: Path, spec: str) -> None:
    path = write_asset(tmp_path, provenance=Provenance(step="select", spec=spec))
    assert take_files(path) == ()


def test_the_sound_around_a_pair_is_the_takes_at_its_moment(folder: Path, tmp_path: Path) -> None:
    rate = 48000
    moments = np.arange(4 * rate) / rate
    with wave.open(str(tmp_path / "kitchen.wav"), "wb") as stream:
        stream.setnchannels(1)
        stream.setsampwidth(2)
        stream.setframerate(rate)
        loud = np.sin(2000 * np.pi * moments) * ((moments > 0.49) & (moments < 0.5))
        stream.writeframes((32000 * loud).astype("<i2").tobytes())
    take = replace(small_take(), audio=tmp_path / "kitchen.wav")
    write_take(tmp_path / "kitchen.take.usda", take, provenance=Provenance())
    shown = pictures(tmp_path)
    for pair in (3, 1):
        data = shown.sound(pair)
        assert data is not None
        with wave.open(io.BytesIO(data)) as heard:
            assert heard.getnframes() == 2 * heard.getframerate()
            samples = np.frombuffer(heard.readframes(heard.getnframes()), "<i2")
        at = np.flatnonzero(np.abs(samples) > 8000).mean() / heard.getframerate() - 1.0
        assert at + (FRAMES[pair] - 101) / 120 == pytest.approx(0.495, abs=0.002)
    assert pictures(folder).sound(0) is None, "its video has no sound"
    assert pictures(folder, takes=[]).sound(0) is None


def test_the_page_sees_the_head_as_it_was_turned(tmp_path: Path) -> None:
    turn = Rotation.from_euler("YXZ", [20, -7, 4], degrees=True)
    motion = np.tile(np.eye(4), (small_take().frame_count, 1, 1))
    motion[7, :3, :3] = turn.as_matrix()
    write_take(
        tmp_path / "kitchen.take.usda",
        replace(small_take(), head_motion=motion),
        provenance=Provenance(),
    )
    here = replace(references(tmp_path), frames=np.array([101, 108, 109, 110, 111]))
    notes, takes = [PairNotes()] * 5, [tmp_path / "kitchen.take.usda"]
    heads = PairPictures(here, notes, takes).head_degrees()
    assert heads[0] == pytest.approx([0, 0, 0], abs=1e-9)
    yaw, pitch, roll = heads[1] or ()
    seen = Rotation.from_euler("ZXY", [roll, pitch, yaw], degrees=True)
    assert (seen * turn.inv()).magnitude() < 1e-6
    assert pictures(tmp_path, takes=[]).head_degrees() == [None] * 5
