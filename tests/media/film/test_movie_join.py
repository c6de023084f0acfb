"""Parts of a movie joined without decoding: nothing lost, nothing encoded twice."""

import os
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from tests.media.bar_code import draw_number, read_number
from usdface.core.errors import InputError
from usdface.media.film.movie import read_movie_comment, write_movie
from usdface.media.film.movie_join import join_movies
from usdface.media.film.sound import read_audio
from usdface.media.film.video import VideoReader

FILM = Fraction(24000, 1001)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm"])
def test_every_picture_of_the_parts_is_there_bit_for_bit(tmp_path: Path, suffix: str) -> None:
    parts, shown = [], []
    for start, stop in ((0, 7), (7, 8), (8, 20)):
        part = tmp_path / f"{start}{suffix}"
        write_movie(part, (draw_number(n) for n in range(start, stop)), rate=FILM)
        with VideoReader(part) as movie:
            shown += [movie.frame(index) for index in range(stop - start)]
        parts.append(part)
    whole = tmp_path / f"whole{suffix}"
    join_movies(whole, parts, rate=FILM, timecode="01:00:00:00", comment="made here")
    assert read_movie_comment(whole) == "made here"
    with VideoReader(whole) as movie:
        assert movie.timecode == "01:00:00:00"
        assert len(movie.times) == 20
        np.testing.assert_allclose(movie.times, np.arange(20) / float(FILM), atol=0.0011)
        for number in range(20):
            assert read_number(movie.frame(number)) == number
            np.testing.assert_array_equal(movie.frame(number), shown[number])


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm"])
def test_every_picture_of_a_movie_is_a_key_frame(tmp_path: Path, suffix: str) -> None:
    movie = tmp_path / f"review{suffix}"
    write_movie(movie, (draw_number(n) for n in range(30)), rate=Fraction(24))
    with av.open(str(movie)) as container:
        keys = [packet.is_keyframe for packet in container.demux(video=0) if packet.size]
    assert keys == [True] * 30


def test_the_sound_lies_under_the_pictures_it_belongs_to(tmp_path: Path) -> None:
    part = tmp_path / "part.mp4"
    write_movie(part, (draw_number(n) for n in range(48)), rate=Fraction(24))
    sound = np.zeros(2 * 48000, np.float32)
    sound[48000:48200] = 0.9  # a click one second in
    join_movies(tmp_path / "whole.mp4", [part], rate=Fraction(24), audio=sound)
    heard = np.abs(read_audio(tmp_path / "whole.mp4", rate=48000))
    assert abs(int(heard.argmax()) - 48000) < 1100  # AAC frames and their pre-echo: 23 ms


def test_parts_of_another_size_are_refused_and_the_old_movie_kept(tmp_path: Path) -> None:
    write_movie(tmp_path / "a.mp4", [np.zeros((64, 64, 3), np.uint8)], rate=FILM)
    write_movie(tmp_path / "b.mp4", [np.zeros((64, 80, 3), np.uint8)], rate=FILM)
    (tmp_path / "whole.mp4").write_bytes(b"kept")
    with pytest.raises(InputError, match=r"b\.mp4: is h?.*80 × 64.*a\.mp4 is"):
        join_movies(tmp_path / "whole.mp4", [tmp_path / "a.mp4", tmp_path / "b.mp4"], rate=FILM)
    assert (tmp_path / "whole.mp4").read_bytes() == b"kept"


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores are not to be chosen")
@pytest.mark.parametrize("proxy", [False, True])
def test_a_movie_has_the_same_bytes_on_any_number_of_cores(tmp_path: Path, proxy: bool) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("one core alone")
    noise = np.random.default_rng(0).integers(0, 255, (200, 320, 3), dtype=np.uint8)
    made = []
    try:
        for used in ({min(cores)}, cores):
            os.sched_setaffinity(0, used)
            pictures = (np.roll(noise, 3 * shift, axis=1) for shift in range(20))
            write_movie(tmp_path / "m.mp4", pictures, rate=Fraction(25), proxy=proxy)
            made.append((tmp_path / "m.mp4").read_bytes())
    finally:
        os.sched_setaffinity(0, cores)
    assert made[0] == made[1]
