"""Sound on an analog channel of a C3D becomes a file that the take refers to."""

import wave
from pathlib import Path

import numpy as np
import pytest

from tests.c3d_write import write_c3d
from tests.capture.text_samples import live_link_csv
from usdface.core.errors import InputError
from usdface.media.film.sound import read_audio
from usdface.runner.execute import execute
from usdface.specs.capture import IngestSpec
from usdface.usdio.take.read import read_take

RATE, PER_FRAME, FRAMES = 60, 200, 120
TONE = np.sin(2 * np.pi * 440 * np.arange(FRAMES * PER_FRAME) / (RATE * PER_FRAME))


def write(folder: Path, labels: tuple[str, ...] = ("Force.Fz", "Audio.1")) -> Path:
    rng = np.random.default_rng(0)
    columns = [rng.normal(size=len(TONE)), 1.5 + 0.2 * TONE]
    path = folder / "shot.c3d"
    write_c3d(
        path,
        rng.normal(0, 50, (FRAMES, 4, 3)),
        np.ones((FRAMES, 4), np.bool_),
        list("abcd"),
        rate=RATE,
        analog=np.stack(columns[: len(labels)], axis=1),
        analog_labels=labels,
    )
    return path


def test_a_channel_named_like_sound_is_found_and_played_true(tmp_path: Path) -> None:
    report = execute(IngestSpec(sources=(write(tmp_path),), out=tmp_path / "shot.take.usda"))
    sound = read_take(tmp_path / "shot.take.usda").audio
    assert sound.name == "shot.take.sound.wav"
    with wave.open(str(sound)) as stream:
        assert (stream.getframerate(), stream.getnframes()) == (RATE * PER_FRAME, len(TONE))
        samples = np.frombuffer(stream.readframes(len(TONE)), "<i2") / 32767
    np.testing.assert_allclose(samples, TONE, atol=1e-3)  # the resting voltage is gone
    assert len(read_audio(sound, rate=16000)) == pytest.approx(2 * 16000, abs=200)
    assert any("analog channel Audio.1 (12000 Hz)" in note for note in report.notes)


def test_sound_of_others_is_kept_and_our_own_replaced(tmp_path: Path) -> None:
    spec = IngestSpec(sources=(write(tmp_path),), out=tmp_path / "shot.take.usda")
    sound = tmp_path / "shot.take.sound.wav"
    sound.write_bytes(b"RIFF, and hours of a sound engineer's work")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"sound\.wav: exists and is not the sound"):
            execute(spec, overwrite=overwrite)
    assert sound.read_bytes().startswith(b"RIFF, and hours")
    assert not spec.out.exists()
    sound.unlink()
    assert sound in execute(spec).outputs
    told = sound.read_bytes()
    spec.out.unlink()  # as a run that was killed leaves it
    execute(spec, overwrite=True)
    assert sound.read_bytes() == told
    write(tmp_path, labels=("Audio.1",))  # another channel: other samples
    execute(spec, overwrite=True)
    assert sound.read_bytes() != told


def test_a_channel_may_be_named(tmp_path: Path) -> None:
    source = write(tmp_path, labels=("Kanal_7",))
    plain = execute(IngestSpec(sources=(source,), out=tmp_path / "a.take.usda"))
    assert not any("sound" in note for note in plain.notes)
    execute(IngestSpec(sources=(source,), out=tmp_path / "b.take.usda", audio_channel="Kanal_7"))
    assert read_take(tmp_path / "b.take.usda").audio.is_file()


def test_a_channel_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path) -> None:
    spec = IngestSpec(sources=(write(tmp_path),), out=tmp_path / "a.take.usda", audio_channel="mic")
    with pytest.raises(InputError, match=r"no analog channel 'mic'; there are Force\.Fz, Audio\.1"):
        execute(spec)


@pytest.mark.parametrize("order", [1, -1])
def test_the_channel_is_looked_for_in_c3d_files_alone_in_whatever_order(
    tmp_path: Path, order: int
) -> None:
    weights = tmp_path / "face.csv"
    weights.write_text(live_link_csv(), encoding="utf-8")
    spec = IngestSpec(
        sources=(write(tmp_path), weights)[::order],
        out=tmp_path / "a.take.usda",
        audio_channel="Audio.1",
    )
    report = execute(spec)
    assert any("analog channel Audio.1" in note for note in report.notes)


def test_a_channel_named_where_no_capture_can_carry_one_is_refused(tmp_path: Path) -> None:
    weights = tmp_path / "face.csv"
    weights.write_text(live_link_csv(), encoding="utf-8")
    spec = IngestSpec(sources=(weights,), out=tmp_path / "a.take.usda", audio_channel="Audio.1")
    with pytest.raises(InputError, match=r"only C3D carries analog channels; leave --audio"):
        execute(spec)


def test_samples_that_are_no_numbers_are_silent_and_spoil_no_other(tmp_path: Path) -> None:
    broken = np.where(np.arange(len(TONE)) % 997 == 5, np.nan, 1.5 + 0.2 * TONE)
    broken[77] = np.inf
    source = tmp_path / "shot.c3d"
    cloud = np.random.default_rng(0).normal(0, 50, (FRAMES, 4, 3))
    seen = np.ones((FRAMES, 4), np.bool_)
    write_c3d(
        source, cloud, seen, "abcd", rate=RATE, analog=broken[:, None], analog_labels=("Audio",)
    )
    execute(IngestSpec(sources=(source,), out=tmp_path / "shot.take.usda"))
    with wave.open(str(tmp_path / "shot.take.sound.wav")) as stream:
        samples = np.frombuffer(stream.readframes(len(TONE)), "<i2") / 32767
    told = np.isfinite(broken)
    np.testing.assert_allclose(samples[told], TONE[told], atol=1e-2)
    np.testing.assert_array_equal(samples[~told], 0)
