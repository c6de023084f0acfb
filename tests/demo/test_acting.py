"""The performance: natural, labelled, the same every time."""

import itertools
from pathlib import Path

import numpy as np

from tests.demo.posed_head import posed
from tests.demo.test_shapes import lid_gap, lip_offset
from usdface.demo.acting import ActedPerformance, performance
from usdface.demo.head import DemoHead
from usdface.demo.script import (
    DURATION_SECONDS,
    LINES,
    VISEME_OF_PHONE,
    VISEME_SHAPES,
    spoken_phones,
    timed_phones,
)
from usdface.demo.voice import speak
from usdface.speech.track_files import read_phone_track, write_phone_track


def channel(acted: ActedPerformance, name: str) -> np.ndarray:
    return acted.weights.values[:, acted.weights.names.index(name)]


def test_it_is_long_enough_and_within_range(acted: ActedPerformance) -> None:
    assert acted.weights.values.shape[0] / float(acted.weights.rate) >= 12.0
    assert acted.weights.values.min() >= 0.0
    assert acted.weights.values.max() <= 1.0
    assert np.all(np.isfinite(acted.weights.values))


def test_the_four_emotions_follow_each_other_without_gaps() -> None:
    moods = spoken_phones().emotions
    assert [e.label for e in moods] == ["neutral", "happiness", "anger", "sadness"]
    for before, after in itertools.pairwise(moods):
        assert before.end == after.start


def test_labels_cover_the_performance(tmp_path: Path) -> None:
    phones = spoken_phones().phones
    assert phones[0].start == 0.0
    assert all(before.end == after.start for before, after in itertools.pairwise(phones))
    assert phones[-1].end == DURATION_SECONDS
    write_phone_track(tmp_path / "actor.phones.json", spoken_phones())
    assert [each.label for each in read_phone_track(tmp_path / "actor.phones.json").phones] == [
        each.label for each in phones
    ]


def test_moods_show_in_their_own_shapes(acted: ActedPerformance) -> None:
    def rows(seconds: float) -> int:
        return round(seconds * float(acted.weights.rate))

    telling = {"happiness": "mouthSmileLeft", "anger": "browDownLeft", "sadness": "mouthFrownLeft"}
    for mood, name in telling.items():
        means = {
            e.label: channel(acted, name)[rows(e.start) : rows(e.end)].mean()
            for e in spoken_phones().emotions
        }
        assert max(means, key=means.__getitem__) == mood
        assert means[mood] > 0.3


def test_the_face_is_at_rest_on_the_neutral_frame(acted: ActedPerformance) -> None:
    index = acted.neutral_frame - acted.weights.first_frame
    assert np.abs(acted.weights.values[index]).max() < 1e-3
    assert np.abs(acted.rotation[index]).max() < 0.5


def test_nothing_jumps(acted: ActedPerformance) -> None:
    """A full swing takes a lid 50 ms, the eyes 55 ms, anything else 120 ms at least."""
    speed = np.abs(np.diff(acted.weights.values, axis=0)).max(axis=0) * float(acted.weights.rate)
    for name, fastest in zip(acted.weights.names, speed, strict=True):
        limit = 21.0 if "Blink" in name else 18.0 if "Look" in name else 8.5
        assert fastest < limit, name


def test_blinks_are_as_long_as_blinks(acted: ActedPerformance) -> None:
    closed = channel(acted, "eyeBlinkLeft") > 0.02
    edges = np.flatnonzero(np.diff(closed.astype(int)))
    lengths = (edges[1::2] - edges[::2]) / float(acted.weights.rate)
    assert len(lengths) >= 8
    assert np.all((lengths > 0.12) & (lengths < 0.26))


def test_every_sound_has_a_look_and_every_look_is_a_shape(character: DemoHead) -> None:
    assert {p.phone for p in timed_phones()} <= set(VISEME_OF_PHONE)
    assert set(VISEME_OF_PHONE.values()) == set(VISEME_SHAPES)
    for look in VISEME_SHAPES.values():
        assert set(look) <= set(character.shapes)


def test_lips_meet_in_sounds_made_with_the_lips(acted: ActedPerformance) -> None:
    rate = float(acted.weights.rate)
    closed = [sound for sound in timed_phones() if sound.phone in ("P", "B", "M")]
    assert closed
    for sound in closed:
        index = round(0.5 * (sound.start + sound.stop) * rate)
        jaw, close = channel(acted, "jawOpen")[index], channel(acted, "mouthClose")[index]
        assert close > 0.95 * jaw


def test_lines_fit_into_their_moods() -> None:
    for line in LINES:
        length = sum(duration for _, duration in line.phones) / 1000.0
        assert line.start < line.speech
        assert line.speech + length <= line.stop


def test_the_performance_is_deterministic(acted: ActedPerformance) -> None:
    again = performance()
    np.testing.assert_array_equal(again.weights.values, acted.weights.values)
    np.testing.assert_array_equal(again.rotation, acted.rotation)


def test_the_voice_speaks_when_the_mouth_does_and_is_silent_at_rest() -> None:
    rate = 16000
    sound = speak(rate)
    assert np.abs(sound).max() <= 1.0
    energy = {}
    for sound_of in timed_phones():
        quarter = 0.25 * (sound_of.stop - sound_of.start)
        first, last = sound_of.start + quarter, sound_of.stop - quarter
        piece = sound[round(first * rate) : round(last * rate)]
        energy.setdefault(sound_of.phone, []).append(float(np.sqrt(np.mean(piece**2))))
    rest = float(np.sqrt(np.mean(sound[: rate // 2] ** 2)))
    assert np.mean(energy["AA"]) > 30.0 * rest
    assert np.mean(energy["AA"]) > 3.0 * np.mean(energy["P"])


def test_lids_never_cross_and_blinks_close_the_eye_in_every_mood(
    character: DemoHead, acted: ActedPerformance
) -> None:
    """Smiles and squints lift the lower lid already: the blink has to leave them room."""
    blink = channel(acted, "eyeBlinkLeft")
    peaks = [k for k in range(1, len(blink) - 1) if blink[k - 1] < blink[k] >= blink[k + 1]]
    assert peaks
    for frame in [*peaks, *range(0, len(blink), 97)]:
        pose = dict(zip(acted.weights.names, acted.weights.values[frame].tolist(), strict=True))
        gap = lid_gap(character, posed(character, pose))
        assert gap.min() > -1.2, frame
        if frame in peaks:
            assert gap.max() < 2.5, frame


def test_lips_touch_on_the_character_in_sounds_made_with_the_lips(
    character: DemoHead, acted: ActedPerformance
) -> None:
    closed = [sound for sound in timed_phones() if sound.phone in ("P", "B", "M")]
    assert closed
    for sound in closed:
        frame = round(0.5 * (sound.start + sound.stop) * float(acted.weights.rate))
        pose = dict(zip(acted.weights.names, acted.weights.values[frame].tolist(), strict=True))
        opening = lip_offset(character, posed(character, pose))[:, 1]
        assert -3.0 < np.median(opening) < 1.5, sound
