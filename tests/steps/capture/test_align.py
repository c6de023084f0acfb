"""A take learns where its video lies, keeps all else, and is left alone where nobody can tell."""

import json
import shutil
import wave
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.media.film.stated_movie import write_stated_movie
from tests.numerics.simulated_sound import Recorder, record, speech, true_line
from tests.usdio.take.test_take import small_take
from usdface.cli.app import main
from usdface.core.assets import Video
from usdface.core.errors import CheckFailedError, InputError
from usdface.core.provenance import Provenance
from usdface.media.film.movie import SAMPLE_RATE
from usdface.media.picture.image import read_image_metadata, write_image
from usdface.runner.execute import execute
from usdface.runner.job import run_job
from usdface.runner.state import job_states
from usdface.specs.capture import AlignSpec, IngestSpec
from usdface.specs.job import JobSpec
from usdface.steps.capture.align import Evidence, TimecodeShift, decide, timecode_shift
from usdface.usdio.layers import read_provenance
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import VideoSync, write_take, write_video_sync
from usdface.usdio.validation import validate

SYNC = ("face:video:offset", "face:video:drift", "face:sync:confidence")
CAPTURE = Recorder(start=0.3, seconds=9.0, rate=SAMPLE_RATE, ppm=30, snr_db=30)
CAMERA = Recorder(start=2.05, seconds=6.0, rate=SAMPLE_RATE, ppm=-40, snr_db=12, reverb_seconds=0.2)
OFFSET, DRIFT = true_line(CAMERA, CAPTURE)


def write_wav(path: Path, sound: np.ndarray) -> None:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        file.writeframes((np.clip(sound, -1, 1) * 32767).astype("<i2").tobytes())


def write_video(path: Path, sound: np.ndarray | None, timecode: str = "") -> None:
    pictures = (np.full((32, 32, 3), n % 255, np.uint8) for n in range(144))
    write_stated_movie(path, pictures, rate=Fraction(24), audio=sound, timecode=timecode)


@pytest.fixture(scope="module")
def sounds() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    event = speech(10.0, rng)
    return record(event, CAMERA, rng), record(event, CAPTURE, rng)


def make_take(
    folder: Path, name: str = "kitchen", *, video: str = "kitchen.mov", audio: bool = True
) -> Path:
    take = replace(
        small_take(),
        video=Video(folder / video, Fraction(24), 7.0),
        audio=folder / "capture.wav" if audio else None,
    )
    made = Provenance("ingest", '{"a":1}', {"kitchen.c3d": "00ff"})
    write_take(folder / f"{name}.take.usda", take, provenance=made)
    return folder / f"{name}.take.usda"


@pytest.fixture(scope="module")
def recorded(sounds, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    write_wav(folder / "capture.wav", sounds[1])
    write_video(folder / "kitchen.mov", sounds[0])
    return make_take(folder)


@pytest.fixture
def take(tmp_path: Path, recorded: Path) -> Path:
    """A take whose start is labelled 01:00:00:00, and a video with sound and no timecode."""
    shutil.copytree(recorded.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / recorded.name


def without_sync(path: Path) -> str:
    """Return all that a layer says but the three attributes."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(Sdf.Layer.OpenAsAnonymous(str(path)))
    root = layer.GetPrimAtPath("/Take")
    for name in SYNC:
        if name in root.attributes:
            root.RemoveProperty(root.attributes[name])
    return layer.ExportToString()


def test_the_video_is_found_by_its_sound(take: Path) -> None:
    report = execute(AlignSpec(take=take))
    video = read_take(take).video
    assert video.offset == pytest.approx(OFFSET, abs=1e-3)
    assert video.drift == pytest.approx(1e6 * DRIFT, abs=20)
    assert report.figures["offset"] == video.offset
    assert 0.5 <= report.figures["confidence"] <= 1
    assert "by sound" in report.summary
    assert validate(take) == []


def test_nothing_else_in_the_take_changes(take: Path) -> None:
    layer = Sdf.Layer.FindOrOpen(str(take))
    layer.comment = "the director liked this one"
    layer.GetPrimAtPath("/Take").SetInfo("customData", {"shot": 12})
    layer.Save()
    others = {each: each.read_bytes() for each in take.parent.iterdir() if each != take}
    before, made = without_sync(take), read_provenance(take)
    execute(AlignSpec(take=take))
    assert without_sync(take) == before
    assert read_provenance(take) == made
    assert {each: each.read_bytes() for each in others} == others
    assert sorted(set(take.parent.iterdir()) - set(others)) == sorted(
        [take, take.with_name("kitchen.take.align.png")]
    )


def test_a_take_over_another_gets_it_as_an_over(take: Path) -> None:
    over = take.with_name("kitchen.clean.take.usda")
    layer = Sdf.Layer.CreateNew(str(over))
    layer.subLayerPaths = [f"./{take.name}"]
    layer.defaultPrim = "Take"
    for name in ("timeCodesPerSecond", "framesPerSecond", "startTimeCode", "endTimeCode"):
        setattr(layer, name, getattr(Sdf.Layer.FindOrOpen(str(take)), name))
    layer.Save()
    before = take.read_bytes()
    write_video_sync(over, VideoSync(1.5, 20.0, 0.8))
    video = read_take(over).video
    assert (video.offset, video.drift) == (1.5, 20.0)
    assert read_take(take).video.offset == 7.0
    assert take.read_bytes() == before


def test_a_doubtful_result_is_refused_with_a_picture_and_leaves_the_take(
    take: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(5)
    write_wav(take.with_name("capture.wav"), record(speech(10.0, rng), CAPTURE, rng))
    before = take.read_bytes()
    with pytest.raises(SystemExit) as stop:
        main(["align", str(take)])
    assert stop.value.code == 1
    said = capsys.readouterr().err
    assert "seem unrelated" in said
    assert "kitchen.take.align.png" in said
    assert "--offset SECONDS" in said
    assert take.read_bytes() == before
    assert read_image_metadata(take.with_name("kitchen.take.align.png"))["step"] == "align refused"


def test_by_hand_the_shift_is_set_without_any_sound(tmp_path: Path) -> None:
    write_video(tmp_path / "kitchen.mov", None)
    take = make_take(tmp_path, audio=False)
    with pytest.raises(CheckFailedError, match=r"no sound recorded with the capture.*--audio"):
        execute(AlignSpec(take=take))
    execute(AlignSpec(take=take, offset=-1.25, drift=8.0), overwrite=True)
    video = read_take(take).video
    assert (video.offset, video.drift) == (-1.25, 8.0)


def test_a_shift_by_hand_is_compared_with_the_sound(take: Path) -> None:
    report = execute(AlignSpec(take=take, offset=OFFSET + 0.1))
    assert read_take(take).video.offset == OFFSET + 0.1
    assert any("a difference of -100.0 ms" in note for note in report.notes), report.notes


def test_timecode_is_used_where_the_sound_confirms_it(take: Path, sounds) -> None:
    write_video(take.with_name("kitchen.mov"), sounds[0], "01:00:01:18")  # 1.75 s
    report = execute(AlignSpec(take=take))
    video = read_take(take).video
    assert video.offset == 1.75
    assert video.drift == pytest.approx(1e6 * DRIFT, abs=20)
    assert report.figures["source"] == "by timecode"
    assert report.figures["confidence"] > 0.75


def test_timecode_that_the_sound_contradicts_is_refused_until_told(take: Path, sounds) -> None:
    write_video(take.with_name("kitchen.mov"), sounds[0], "01:00:04:00")
    with pytest.raises(CheckFailedError, match=r"is \+4\.000 s by timecode and \+1\.75"):
        execute(AlignSpec(take=take))
    assert read_take(take).video.offset == 7.0
    execute(AlignSpec(take=take, by="sound"))
    assert read_take(take).video.offset == pytest.approx(OFFSET, abs=1e-3)
    execute(AlignSpec(take=take, by="timecode"))
    assert read_take(take).video.offset == 4.0


def test_timecode_without_sound_is_used_and_said_to_be_unchecked() -> None:
    evidence = Evidence(None, "no microphone", TimecodeShift(2.5, 0.05))
    decision = decide(AlignSpec(take=Path("x.usda")), evidence)
    assert decision.sync == VideoSync(2.5, 0.0, 0.5)
    assert "could not be checked against the sound: no microphone" in decision.notes[0]


def test_a_job_aligns_once_and_again_after_the_take_was_made_anew(take: Path) -> None:
    raw = make_take(take.parent, "raw")
    take = take.with_name("new.take.usda")
    job = JobSpec(
        job="kitchen",
        steps=(
            IngestSpec(
                sources=(raw,),
                out=take,
                video=take.with_name("kitchen.mov"),
                audio=take.with_name("capture.wav"),
            ),
            AlignSpec(take=take),
        ),
    )
    run_job(job)
    assert read_take(take).video.offset == pytest.approx(OFFSET, abs=1e-3)
    assert [each.state for each in job_states(job)] == ["done", "done"]
    layer = Sdf.Layer.FindOrOpen(str(raw))
    layer.GetAttributeAtPath("/Take.face:performer").default = "Bea"
    layer.Save()
    assert [each.state for each in job_states(job)] == ["stale", "stale"]
    run_job(job)
    assert [each.state for each in job_states(job)] == ["done", "done"]
    assert read_take(take).video.offset == pytest.approx(OFFSET, abs=1e-3)


def test_a_refusal_is_not_taken_for_done_by_a_job(take: Path) -> None:
    rng = np.random.default_rng(5)
    write_wav(take.with_name("capture.wav"), record(speech(10.0, rng), CAPTURE, rng))
    job = JobSpec(job="kitchen", steps=(AlignSpec(take=take),))
    for _ in range(2):
        with pytest.raises(CheckFailedError):
            run_job(job)
    assert job_states(job)[0].state == "stale"


def test_a_picture_of_someone_else_is_not_replaced(take: Path) -> None:
    picture = take.with_name("kitchen.take.align.png")
    picture.write_bytes(b"mine")
    with pytest.raises(InputError, match="was not written by usdface"):
        execute(AlignSpec(take=take))
    assert picture.read_bytes() == b"mine"


def test_pictures_have_no_sound_but_may_be_placed_by_hand(take: Path) -> None:
    for number in (1, 2, 3):
        picture = np.full((32, 32, 3), number, np.uint8)
        write_image(take.with_name(f"kitchen.{number:04d}.png"), picture)
    take = make_take(take.parent, video="kitchen.0001.png")
    with pytest.raises(CheckFailedError, match="an image sequence has no sound"):
        execute(AlignSpec(take=take))
    execute(AlignSpec(take=take, offset=0.5), overwrite=True)
    assert read_take(take).video.offset == 0.5


def test_a_take_without_video_says_how_to_get_one(tmp_path: Path) -> None:
    write_take(tmp_path / "x.take.usda", replace(small_take(), video=None), provenance=Provenance())
    with pytest.raises(InputError, match="no video to align; ingest the capture with --video"):
        execute(AlignSpec(take=tmp_path / "x.take.usda"))


def test_the_result_can_be_read_by_a_script(take: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["align", str(take), "--json"])
    assert stop.value.code == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["offset"] == pytest.approx(OFFSET, abs=1e-3)
    assert figures["sound"]["doubts"] == []


NTSC, FILM = Fraction(30000, 1001), Fraction(24000, 1001)


@pytest.mark.parametrize(
    ("take_start", "take_rate", "video_start", "video_rate", "offset"),
    [
        ("01:00:00:00", Fraction(120), "01:00:02:12", Fraction(24), 2.5),
        ("01:00:02:15", Fraction(60), "01:00:02:00", Fraction(25), -0.5),
        ("23:59:59:00", Fraction(120), "00:00:01:00", Fraction(30), 2.0),
        ("00:00:01:00", Fraction(24), "23:59:59:00", Fraction(24), -2.0),
        ("10:00:00:00", 4 * NTSC, "10:00:10:00", FILM, 10.01),
        ("10:00:00;00", 2 * NTSC, "10:01:00;02", NTSC, 60.06),
        ("23:59:59;00", NTSC, "00:00:00;00", NTSC, 1.001),
        ("23:59:59:00", NTSC, "00:00:00:00", NTSC, 1.001),
    ],
)
def test_labels_give_the_shift(take_start, take_rate, video_start, video_rate, offset) -> None:
    found = timecode_shift(take_start, take_rate, video_start, video_rate, first_picture=0.0)
    assert found.offset == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize(
    ("take_start", "take_rate", "video_start", "video_rate", "reason"),
    [
        ("", Fraction(120), "01:00:00:00", Fraction(24), "the take carries no timecode"),
        ("", Fraction(120), "", Fraction(24), "the take and the video carry no timecode"),
        ("01:00:00:00", Fraction(120), "01:00:00:00", None, "not evenly spaced"),
        ("01:00:00:00", Fraction(120), "01:00:00:00", FILM, "120 and 23.976 does not count"),
        ("01:00:00:00", NTSC, "01:00:00;00", NTSC, "29.97 and 29.97 drop frame"),
        ("01:00:00:00", Fraction(24), "01:00:00:27", Fraction(24), "does not exist"),
    ],
)
def test_labels_that_cannot_be_compared_say_why(
    take_start, take_rate, video_start, video_rate, reason
) -> None:
    found = timecode_shift(take_start, take_rate, video_start, video_rate)
    assert found.offset is None
    assert reason in found.reason
