import wave
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from tests.media.bar_code import (
    HEIGHT,
    WIDTH,
    draw_number,
    read_number,
    turn_in_header,
    write_numbered,
)
from tests.media.film.stated_movie import write_stated_movie
from usdface.core.errors import InputError
from usdface.media.film import movie as movie_writer
from usdface.media.film import video
from usdface.media.film.movie import write_movie
from usdface.media.film.sound import read_audio
from usdface.media.film.video import VideoReader

FILM = Fraction(24000, 1001)
needs_h264 = pytest.mark.skipif(
    "libx264" not in av.codecs_available, reason="this PyAV cannot encode H.264 with B-frames"
)


def pictures(count: int):
    return (draw_number(number) for number in range(count))


def test_written_movie_gives_every_frame_back_at_random_times(tmp_path: Path) -> None:
    path = tmp_path / "review.mp4"
    write_stated_movie(path, pictures(60), rate=FILM, timecode="01:02:03:04")
    rng = np.random.default_rng(0)
    with VideoReader(path) as movie:
        assert movie.rate == FILM
        assert movie.timecode == "01:02:03:04"
        assert movie.duration == pytest.approx(60 / FILM)
        for number in rng.integers(0, 60, 25):
            picture = movie.frame_at(float((number + rng.uniform(0, 0.99)) / FILM))
            assert picture is not None
            assert read_number(picture) == number


@needs_h264
def test_constant_rate_with_b_frames_is_read_frame_exactly(tmp_path: Path) -> None:
    path = tmp_path / "cfr.mp4"
    write_numbered(path, list(range(200)), base=1 / FILM, rate=FILM)
    with VideoReader(path) as movie:
        assert movie.rate == FILM
        order = np.random.default_rng(0).permutation(200)[:40]
        read = [read_number(movie.frame_at(float(n / FILM))) for n in order]
        np.testing.assert_array_equal(read, order)
        assert [read_number(movie.frame(n)) for n in range(90, 130)] == list(range(90, 130))


@needs_h264
@pytest.mark.parametrize("group", [1, 4])
def test_reading_on_never_seeks(tmp_path: Path, monkeypatch, group: int) -> None:
    """Key frames that lie on the way are decoded like others."""
    path = tmp_path / "keys.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"g": str(group), "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(20):
            frame = av.VideoFrame.from_ndarray(draw_number(number), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with VideoReader(path) as reader:
        seeks, held = [], reader._container

        class Counting:
            def seek(self, *where, **how):
                seeks.append(where)
                held.seek(*where, **how)

            def __getattr__(self, name):
                return getattr(held, name)

        monkeypatch.setattr(reader, "_container", Counting())
        assert [read_number(reader.frame(index)) for index in range(20)] == list(range(20))
        assert not seeks
        assert read_number(reader.frame(3)) == 3
        assert read_number(reader.frame(15)) == 15
        assert len(seeks) == 2


def test_variable_rate_shows_the_frame_whose_own_time_has_come(tmp_path: Path) -> None:
    path = tmp_path / "vfr.mp4"
    rng = np.random.default_rng(0)
    stamps = np.concatenate([[0], np.cumsum(rng.choice([1500, 3000, 3750, 6000], 199))])
    write_numbered(path, stamps.tolist(), base=Fraction(1, 90000), rate=Fraction(30))
    with VideoReader(path) as movie:
        assert movie.rate is None
        np.testing.assert_allclose(movie.times, stamps / 90000, atol=1e-9)
        for seconds in rng.uniform(0, stamps[-1] / 90000, 30):
            expected = int(np.searchsorted(stamps, seconds * 90000, side="right")) - 1
            assert read_number(movie.frame_at(float(seconds))) == expected


def test_table_of_contents_of_lone_frames_is_what_reading_them_all_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "intra.mov"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=FILM)
        stream.width, stream.height, stream.pix_fmt = 320, 180, "yuvj420p"
        for number in range(40):
            frame = av.VideoFrame.from_ndarray(draw_number(number), format="rgb24")
            container.mux(stream.encode(frame.reformat(format="yuvj420p")))
        container.mux(stream.encode())
    with VideoReader(path) as quick:
        assert [read_number(quick.frame(n)) for n in (0, 17, 39, 3)] == [0, 17, 39, 3]
        times, duration = quick.times, quick.duration
    monkeypatch.setattr(video, "_table_of_contents", lambda *_: None)
    with VideoReader(path) as thorough:
        np.testing.assert_array_equal(thorough.times, times)
        assert thorough.duration == pytest.approx(duration)


def test_rotated_movie_is_turned_upright(tmp_path: Path) -> None:
    path = tmp_path / "phone.mp4"
    write_movie(path, pictures(8), rate=Fraction(30))
    turn_in_header(path)
    with VideoReader(path) as movie:
        assert (movie.width, movie.height) == (180, 320)
        upright = movie.frame_at(5 / 30)
    assert upright is not None
    assert read_number(np.rot90(upright, 1)) == 5  # clockwise as shown, back to how it was drawn


def test_colours_survive_the_movie(tmp_path: Path) -> None:
    path = tmp_path / "colour.mp4"
    colours = np.array([[200, 40, 40], [40, 180, 60], [50, 60, 210], [128, 128, 128]], np.uint8)
    picture = np.repeat(np.repeat(colours[None], 64, axis=0), 64, axis=1).reshape(64, 256, 3)
    write_movie(path, [picture] * 3, rate=Fraction(25))
    with VideoReader(path) as movie:
        read = movie.frame(1)
    assert read is not None
    difference = read[32, 32::64].astype(int) - colours
    # BT.709 tags on an unspecified small picture would read as BT.601: errors of 15 and more.
    assert np.abs(difference).max() <= 4


def test_odd_sizes_grow_to_even_ones(tmp_path: Path) -> None:
    path = tmp_path / "odd.mov"
    write_movie(path, [np.full((101, 203, 3), 90, np.uint8)] * 2, rate=Fraction(24))
    with VideoReader(path) as movie:
        assert (movie.width, movie.height) == (204, 102)


def test_there_is_no_frame_before_and_after_the_movie(tmp_path: Path) -> None:
    path = tmp_path / "short.mp4"
    write_movie(path, pictures(10), rate=Fraction(10))
    with VideoReader(path) as movie:
        assert movie.frame_at(-0.05) is None
        assert movie.frame_at(1.05) is None
        assert read_number(movie.frame_at(0.99)) == 9


@pytest.mark.skipif("libvpx-vp9" not in av.codecs_available, reason="this PyAV has no VP9")
def test_without_h264_the_movie_is_vp9_and_reads_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(movie_writer, "_H264", ())
    path = tmp_path / "review.mp4"
    write_movie(path, pictures(12), rate=Fraction(25))
    with VideoReader(path) as movie:
        assert [read_number(movie.frame(n)) for n in (7, 2, 11)] == [7, 2, 11]
    with av.open(str(path)) as container:
        assert container.streams.video[0].codec.name.startswith(("vp9", "libvpx"))


def test_pictures_of_wide_pixels_are_as_wide_as_players_show_them(tmp_path: Path) -> None:
    path = tmp_path / "anamorphic.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.pix_fmt = "yuv420p"
        stream.height, stream.width = draw_number(0).shape[:2]
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        picture = av.VideoFrame.from_ndarray(draw_number(0), format="rgb24")
        container.mux(stream.encode(picture))
        container.mux(stream.encode())
    with VideoReader(path) as movie:
        assert movie.height == stream.height
        assert movie.width == round(stream.width * 4 / 3)


def test_sound_comes_back_where_it_was(tmp_path: Path) -> None:
    path = tmp_path / "clap.mp4"
    sound = np.zeros(96000, np.float32)
    sound[48000:48200] = 0.9
    write_movie(path, pictures(48), rate=Fraction(24), audio=sound)
    read = read_audio(path, rate=16000)
    assert read.dtype == np.float32
    assert abs(int(np.argmax(np.abs(read))) - 16000) < 100


@pytest.mark.parametrize("channels", [1, 2, 6, 8, 16])
def test_sound_of_several_channels_is_their_mean(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "tracks.wav"
    samples = np.zeros((16000, channels), np.int16)
    samples[8000:8100, channels // 2] = 16384  # of six the fourth, which FFmpeg takes for bass
    samples[12000:12100] = 32767
    with wave.open(str(path), "wb") as stream:
        stream.setparams((channels, 2, 16000, 0, "NONE", ""))
        stream.writeframes(samples.tobytes())
    np.testing.assert_allclose(read_audio(path), samples.mean(axis=1) / 32768, atol=1e-4)


def test_movie_without_sound_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "silent.mp4"
    write_movie(path, pictures(2), rate=Fraction(24))
    with pytest.raises(InputError, match=r"silent\.mp4: holds no sound"):
        read_audio(path)


def test_sound_with_samples_that_are_no_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "take.wav"
    samples = np.zeros((1, 4800), np.float32)
    samples[0, 100] = np.nan
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_f32le", rate=48000, layout="mono")
        frame = av.AudioFrame.from_ndarray(samples, format="flt", layout="mono")
        frame.sample_rate = 48000
        container.mux(stream.encode(frame))
    with pytest.raises(InputError, match=r"take\.wav: its sound holds NaN or infinite samples"):
        read_audio(path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.mp4", b""),
        ("text.mp4", b"this is a letter, not a movie\n" * 100),
        ("noise.mov", bytes(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8))),
        ("playlist.mp4", b"#EXTM3U\n#EXTINF:10,\nhttp://localhost/secret.ts\n#EXT-X-ENDLIST\n"),
        ("script.mp4", b"ffconcat version 1.0\nfile /etc/hostname\n"),
    ],
    ids=["empty", "text", "noise", "playlist", "script"],
)
def test_what_is_no_movie_is_refused_by_name(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        VideoReader(path)
    with pytest.raises(InputError, match=name):
        read_audio(path)


@pytest.mark.parametrize("container", ["mp4", "mkv"])
def test_truncated_movie_is_refused_by_name(tmp_path: Path, container: str) -> None:
    whole, cut = tmp_path / f"whole.{container}", tmp_path / f"cut.{container}"
    write_movie(whole, pictures(48), rate=Fraction(24))
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) // 3] if container == "mp4" else data[:600])
    with pytest.raises(InputError, match=rf"cut\.{container}"):
        VideoReader(cut)


@needs_h264
def test_movie_whose_header_promises_more_is_refused(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.mp4", tmp_path / "cut.mp4"
    write_numbered(whole, list(range(120)), base=1 / FILM, rate=FILM, movflags="faststart")
    data = whole.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    cut.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(InputError, match=r"cut\.mp4.*cut short"):
        VideoReader(cut)


def test_missing_movie_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.mp4: no such file"):
        VideoReader(tmp_path / "absent.mp4")


def test_failed_write_leaves_the_old_movie_and_no_rubbish(tmp_path: Path) -> None:
    path = tmp_path / "review.mp4"
    write_movie(path, pictures(3), rate=Fraction(24))
    before = path.read_bytes()

    def failing():
        yield draw_number(1)
        raise RuntimeError("the render failed")

    with pytest.raises(RuntimeError, match="the render failed"):
        write_movie(path, failing(), rate=Fraction(24))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["review.mp4"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": "review.gif"}, "movies end in"),
        ({"frames": []}, "no frame to write"),
        ({"frames": [np.zeros((8, 8, 3), np.uint8), np.zeros((8, 9, 3), np.uint8)]}, "picture 1"),
        ({"path": "nowhere/review.mp4"}, "does not exist"),
    ],
    ids=["extension", "no frames", "sizes", "folder"],
)
def test_movie_that_cannot_be_written_says_why(tmp_path: Path, change: dict, message: str) -> None:
    arguments = {"path": "a.mp4", "frames": [draw_number(0)], "rate": Fraction(24)}
    arguments |= change
    path = tmp_path / str(arguments.pop("path"))
    with pytest.raises(InputError, match=message):
        write_movie(path, arguments.pop("frames"), **arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_proxy_encodes_a_picture_that_stays_once_and_lasts_to_its_end(tmp_path: Path) -> None:
    numbered = [draw_number(number) for number in range(4)]
    shown = [0] * 5 + [1] * 4 + [2] + [3] * 6
    path = tmp_path / "proxy.mp4"
    rate = Fraction(120000, 1001)
    write_movie(path, (numbered[number] for number in shown), rate=rate, proxy=True)
    with VideoReader(path) as video:
        assert len(video.times) == 5  # and the last once more, for its end
        assert video.duration == pytest.approx(len(shown) / float(rate), abs=1e-4)
        seen = [read_number(video.frame_at((at + 0.5) / float(rate))) for at in range(len(shown))]
    assert seen == shown
