"""Sound and words become phones; what does not fit is said."""

import wave
from difflib import SequenceMatcher
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from usdface.core.assets import Take, Video, WeightsClip
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.media.film.sound import read_audio
from usdface.runner.execute import execute
from usdface.runner.origin import make_provenance, provenance_of
from usdface.runner.result import StepResult
from usdface.specs.capture import PhonesSpec
from usdface.speech.phones import PhoneTrack, Span, arpabet_of, share_outside, viseme_of
from usdface.speech.track_files import read_phone_track
from usdface.steps.capture.phones import _on_take_clock
from usdface.usdio.take.write import write_take

pytest.importorskip("pocketsphinx")
pytest.importorskip("praatio")


@pytest.fixture
def speech(shared_data: Path) -> Path:
    return shared_data / "speech_mfa"


def write_wave(path: Path, samples: np.ndarray) -> Path:
    with wave.open(str(path), "wb") as stream:
        stream.setnchannels(1)
        stream.setsampwidth(2)
        stream.setframerate(16000)
        stream.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
    return path


@pytest.fixture
def excerpt(speech: Path, tmp_path: Path) -> tuple[Path, str]:
    """The first six of 27 seconds of sound, and their words; time is proportional to both."""
    samples = read_audio(speech / "wav" / "acoustic_corpus.wav")[: 16000 * 6]
    words = (speech / "lab" / "acoustic_corpus.lab").read_text("utf-8").split()[:17]
    return write_wave(tmp_path / "excerpt.wav", samples), " ".join(words)


def said(track: PhoneTrack) -> list[Span]:
    return [span for span in track.phones if viseme_of(span.label) != "pau"]


@pytest.mark.slow
def test_phones_lie_where_another_aligner_found_them(speech: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.TextGrid"
    report = execute(
        PhonesSpec(
            audio=speech / "wav" / "acoustic_corpus.wav",
            transcript=speech / "lab" / "acoustic_corpus.lab",
            out=out,
        )
    )
    ours = said(read_phone_track(out))
    theirs = said(read_phone_track(speech / "textgrid" / "acoustic_corpus.TextGrid"))
    blocks = SequenceMatcher(
        None,
        [arpabet_of(span.label) for span in ours],
        [arpabet_of(span.label) for span in theirs],
        autojunk=False,
    ).get_matching_blocks()
    errors = [
        abs(ours[i + k].middle - theirs[j + k].middle) for i, j, n in blocks for k in range(n)
    ]
    assert len(errors) > 0.9 * len(theirs)
    assert np.median(errors) <= 0.020
    assert report.figures["guessed"] == {"yknow": "Y K N OW"}
    assert any("yknow (Y K N OW)" in note for note in report.notes)


def test_a_users_dictionary_says_how_a_name_is_said(
    excerpt: tuple[Path, str], tmp_path: Path
) -> None:
    (tmp_path / "own.dict").write_text("yknow Y AH N OW\n", encoding="utf-8")
    audio, words = excerpt
    report = execute(
        PhonesSpec(
            audio=audio,
            text=words,
            dictionary=tmp_path / "own.dict",
            out=tmp_path / "x.json",
        )
    )
    assert report.figures["guessed"] == {}
    assert read_phone_track(tmp_path / "x.json").words


@pytest.mark.parametrize("other", ["cold_corpus", "cold_corpus3"])
def test_a_transcript_of_other_words_is_refused(
    speech: Path, excerpt: tuple[Path, str], tmp_path: Path, other: str
) -> None:
    words = (speech / "lab" / f"{other}.lab").read_text("utf-8").split()[:17]
    with pytest.raises(InputError, match="transcript of another recording"):
        execute(PhonesSpec(audio=excerpt[0], text=" ".join(words), out=tmp_path / "x.TextGrid"))
    assert not (tmp_path / "x.TextGrid").exists()


def test_silence_and_noise_hold_no_words(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    quiet = write_wave(tmp_path / "quiet.wav", np.zeros(16000))
    noise = write_wave(tmp_path / "noise.wav", 0.3 * rng.standard_normal(32000))
    for sound, message in ((quiet, "the sound is silent"), (noise, "another recording")):
        with pytest.raises(InputError, match=message):
            execute(PhonesSpec(audio=sound, text="hello world", out=tmp_path / "x.json"))


def test_no_audio_no_transcript_no_words_are_said_plainly(speech: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.TextGrid"
    with pytest.raises(ValidationError, match="no transcript is given"):
        PhonesSpec(audio=tmp_path / "x.wav", out=out)
    with pytest.raises(InputError, match=r"x\.wav: no such file"):
        execute(PhonesSpec(audio=tmp_path / "x.wav", text="hello", out=out))
    sound = speech / "wav" / "acoustic_corpus.wav"
    with pytest.raises(InputError, match="has no word;"):
        execute(PhonesSpec(audio=sound, text="[noise]", out=out))
    with pytest.raises(ValidationError, match=r"must end in \.textgrid"):
        PhonesSpec(audio=sound, text="hello", out=tmp_path / "x.txt")


def make_take(path: Path, audio: Path | None) -> Path:
    clip = WeightsClip(("jawOpen",), np.zeros((4, 1), np.float32), 1, Fraction(24))
    write_take(
        path, Take(path.stem, Fraction(24), 1, source=clip, audio=audio), provenance=Provenance()
    )
    return path


def test_a_take_without_sound_is_refused(tmp_path: Path) -> None:
    take = make_take(tmp_path / "deaf.take.usda", None)
    with pytest.raises(InputError, match="no sound and no video"):
        execute(PhonesSpec(audio=take, text="hello", out=tmp_path / "x.json"))


def test_a_takes_own_sound_is_used(speech: Path, tmp_path: Path) -> None:
    samples = read_audio(speech / "wav" / "acoustic_corpus.wav")[: 16000 * 4]
    words = " ".join((speech / "lab" / "acoustic_corpus.lab").read_text().split()[:9])
    sound = write_wave(tmp_path / "x.wav", samples)
    take = make_take(tmp_path / "x.take.usda", sound)
    for number, audio in enumerate((sound, take)):
        execute(PhonesSpec(audio=audio, text=words, out=tmp_path / f"{number}.json"))
    first, second = (read_phone_track(tmp_path / f"{n}.json") for n in (0, 1))
    assert first == second


def test_the_cameras_sound_is_brought_onto_the_takes_clock() -> None:
    track = PhoneTrack((Span(0, 1, "AH"), Span(1, 2, "B")), (Span(0, 2, "ab"),), (), 2.0)
    moved = _on_take_clock(track, Video(Path("camera.mov"), offset=-1.5, drift=1000.0))
    assert [(round(s.start, 4), round(s.end, 4), s.label) for s in moved.phones] == [
        (0.0, 0.502, "B")
    ]
    assert moved.duration == pytest.approx(0.502)


def test_any_loudness_gives_the_same_phones(speech: Path, tmp_path: Path) -> None:
    samples = read_audio(speech / "wav" / "acoustic_corpus.wav")[: 16000 * 5]
    words = (speech / "lab" / "acoustic_corpus.lab").read_text().split()[:14]
    found = []
    for gain in (1.0, 0.05):
        sound = write_wave(tmp_path / f"{gain}.wav", gain * samples)
        out = tmp_path / f"{gain}.json"
        execute(PhonesSpec(audio=sound, text=" ".join(words), out=out))
        found.append([span.middle for span in said(read_phone_track(out))])
    np.testing.assert_allclose(found[0], found[1], atol=0.05)


@pytest.mark.parametrize("suffix", [".TextGrid", ".json"])
def test_phones_know_what_made_them_so_that_a_job_need_not_make_them_again(
    speech: Path, tmp_path: Path, suffix: str
) -> None:
    samples = read_audio(speech / "wav" / "acoustic_corpus.wav")[: 16000 * 4]
    words = " ".join((speech / "lab" / "acoustic_corpus.lab").read_text().split()[:9])
    sound = write_wave(tmp_path / "x.wav", samples)
    spec = PhonesSpec(audio=sound, text=words, out=tmp_path / f"x{suffix}")
    execute(spec)
    made = provenance_of(spec.out)
    assert made == make_provenance(spec)
    assert said(read_phone_track(spec.out))


def test_a_transcript_that_lacks_most_of_what_is_said_is_noticed(
    excerpt: tuple[Path, str], tmp_path: Path
) -> None:
    audio, words = excerpt[0], excerpt[1].split()

    def aligned(text: str) -> StepResult:
        spec = PhonesSpec(audio=audio, text=text, out=tmp_path / "x.json")
        return execute(spec, overwrite=True)

    whole, half = aligned(" ".join(words)), aligned(" ".join(words[: len(words) // 2]))
    assert not any("transcript is incomplete" in note for note in whole.notes)
    assert any("transcript is incomplete" in note for note in half.notes)
    assert whole.figures["sound_outside_words"] < 0.35 < 0.5 < half.figures["sound_outside_words"]


def test_sound_outside_words_is_measured_over_what_is_loud() -> None:
    seconds = np.arange(16000 * 4) / 16000
    loud = (seconds < 1) | (seconds >= 2)  # three seconds of sound, one of pause
    samples = np.where(loud, np.sin(2 * np.pi * 200 * seconds), 0.0).astype(np.float32)
    assert share_outside(samples, [], rate=16000) == 1.0
    assert share_outside(samples, [Span(0.0, 4.0, "all")], rate=16000) == 0.0
    one = share_outside(samples, [Span(0.0, 2.0, "one")], rate=16000)
    assert one == pytest.approx(2 / 3)
