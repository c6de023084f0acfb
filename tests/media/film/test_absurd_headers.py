"""Movies, sound and pictures whose headers lie: refused by name, or read in bounded memory.

Read in a process of its own with a limit on its memory, as libraries of C++ do the reading.
"""

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest

from tests.faults.media_reader import MediaReader
from tests.faults.media_samples import (
    EVERY,
    MOVIES,
    SOUNDS,
    STILLS,
    Size,
    change_wav,
    has_encoder,
    readers_of,
    size_dpx,
    size_exr,
    size_jpeg,
    size_png,
    size_quicktime,
    size_tiff,
    write_sample,
)
from usdface.core.errors import InputError
from usdface.media.film.sound import read_audio

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/statm").is_file(), reason="memory in use is read from /proc"
)


@pytest.fixture(scope="module")
def reader() -> Iterator[MediaReader]:
    with MediaReader() as process:
        yield process


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("samples")
    return {name: write_sample(folder, name).read_bytes() for name in EVERY if has_encoder(name)}


def sample(samples: dict[str, bytes], name: str) -> bytes:
    if name not in samples:
        pytest.skip(f"no encoder here makes {name}")
    return samples[name]


def answers(reader: MediaReader, folder: Path, name: str, content: bytes) -> dict[str, str]:
    path = folder / name
    path.write_bytes(content)
    return {kind: reader.ask(kind, path) for kind in readers_of(name)}


def is_bearable(answer: str) -> bool:
    return answer == "read" or answer.startswith("refused: ")


@pytest.mark.parametrize("name", EVERY)
def test_samples_are_read_whole(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    told = answers(reader, tmp_path, name, sample(samples, name))
    if name in MOVIES:
        assert "holds no sound" in told.pop("sound")
    assert set(told.values()) == {"read"}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("length", [0, 1, 11, 40])
def test_a_file_that_only_begins_is_refused_by_name(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path, name: str, length: int
) -> None:
    told = answers(reader, tmp_path, name, sample(samples, name)[:length])
    assert [each[:8] for each in told.values()] == ["refused:"] * len(told), told


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("other", ["x.0001.png", "x.0001.exr", "x.mp4", "x.webm", "x.wav"])
def test_a_file_under_another_kinds_name_is_read_or_refused(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path, name: str, other: str
) -> None:
    path = tmp_path / other
    path.write_bytes(sample(samples, name))
    for kind in ("movie", "sound", "picture", "metadata"):
        assert is_bearable(reader.ask(kind, path))


SIZES: dict[str, Size] = {
    "f.0001.png": size_png,
    "f.0001.jpg": size_jpeg,
    "f.0001.tif": size_tiff,
    "f.0001.exr": size_exr,
    "f.0001.dpx": size_dpx,
    "mjpeg.avi": size_jpeg,
    "mjpeg.mov": size_jpeg,
    "h264.mp4": size_quicktime,
    "mpeg4.mp4": size_quicktime,
    "prores.mov": size_quicktime,
}
NARROW = ("f.0001.jpg", "mjpeg.avi", "mjpeg.mov", "h264.mp4", "mpeg4.mp4", "prores.mov")
"""Their headers have 16 bits for a side."""


@pytest.mark.parametrize(
    ("width", "height"),
    [(0, 0), (1, 65535), (65535, 65535), (10**6, 10**6), (2**31 - 1, 2**31 - 1)],
)
@pytest.mark.parametrize("name", SIZES)
def test_a_size_that_no_picture_has_asks_for_no_memory(
    reader: MediaReader,
    samples: dict[str, bytes],
    tmp_path: Path,
    name: str,
    width: int,
    height: int,
) -> None:
    if name in NARROW:
        width, height = min(width, 65535), min(height, 65535)
    told = answers(reader, tmp_path, name, SIZES[name](sample(samples, name), width, height))
    assert all(map(is_bearable, told.values())), told
    if name in STILLS:  # a movie's pictures tell their size again
        assert told["picture"].startswith("refused: ")


@pytest.mark.parametrize("name", ["f.0001.png", "f.0001.tif", "f.0001.exr", "f.0001.dpx"])
def test_what_is_missing_of_a_picture_is_not_shown_as_black(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    content = samples[name]
    told = answers(reader, tmp_path, name, content[: 2 * len(content) // 3])
    assert told["picture"].startswith("refused: ")
    assert told["movie"].startswith("refused: ")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"rate": 1}, "its sound is of 1 Hz"),
        ({"rate": 0}, "cannot be read as a movie or sound"),
        ({"rate": 2**31 - 1}, "its sound is of 2147483647 Hz"),
        ({"channels": 65535}, "cannot be read as a movie or sound"),
        ({"channels": 65535, "align": 65535}, "cannot be read as a movie or sound"),
        ({"bits": 0}, "its sound is of an unknown codec"),
        ({"data": 2**32 - 1}, ""),
    ],
    ids=str,
)
def test_a_wav_header_that_lies(
    reader: MediaReader,
    samples: dict[str, bytes],
    tmp_path: Path,
    fields: dict[str, int],
    message: str,
) -> None:
    told = answers(reader, tmp_path, "a.wav", change_wav(samples["a.wav"], **fields))["sound"]
    assert is_bearable(told)
    assert message in told


@pytest.mark.parametrize("name", ["mjpeg.avi", "mjpeg.mov", "vp9.webm", "a.flac"])
def test_a_packing_that_nobody_knows_is_refused_by_name(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    content = sample(samples, name)
    for known in (b"MJPG", b"jpeg", b"V_VP9", b"fLaC"):
        content = content.replace(known, b"?" * len(known))
    told = answers(reader, tmp_path, name, content)
    assert [each[:8] for each in told.values()] == ["refused:"] * len(told), told


def test_a_caption_in_other_letters_or_of_another_type_is_none(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path
) -> None:
    path = tmp_path / "f.0001.exr"
    for old, new in (
        (b'{"a": 1}', b'{"\xe9": 1}'),
        (b"\0string\0\x08\0", b"\0v2f\0\x08\0\0\0\0\0"),
    ):
        content = samples[path.name]
        assert old in content
        path.write_bytes(content.replace(old, new))
        assert is_bearable(reader.ask("metadata", path))
        assert is_bearable(reader.ask("picture", path))


def test_a_header_that_holds_no_text_is_refused_all_the_same(
    reader: MediaReader, samples: dict[str, bytes], tmp_path: Path
) -> None:
    content = samples["f.0001.exr"].replace(b"channels\0chlist\0", b"channels\0\xc9hlist\0")
    told = answers(reader, tmp_path, "f.0001.exr", content)
    assert all(each.startswith("refused: ") for each in told.values())
    assert all("bytes that are not text" in each for each in told.values())


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ocio_profile_version: 2\n",
        b"ocio_profile_version: 99\n",
        b"\x00\xff" * 99,
        b"[" * 9999,
    ],
    ids=["empty", "nothing in it", "of another time", "no text", "deep"],
)
def test_a_colour_configuration_that_is_none_is_refused_by_name(
    reader: MediaReader, tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "config.ocio"
    path.write_bytes(content)
    assert reader.ask("view", path).startswith("refused: ")


def test_a_process_that_a_file_ends_is_started_anew(reader: MediaReader, tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(b"")
    assert reader.ask("end", path) == "ended: the process ended with 3"
    assert reader.ask("sound", path).startswith("refused: ")


def test_every_kind_is_here() -> None:
    assert {*MOVIES, *SOUNDS, *STILLS} == set(EVERY)


def test_sound_that_jumps_by_hours_asks_for_no_hours_of_silence(tmp_path: Path) -> None:
    path = tmp_path / "jump.mkv"
    with av.open(str(path), "w") as sound:
        stream = sound.add_stream("pcm_s16le", rate=16_000, layout="mono")
        for start in (0, 16_000 * 7200):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.int16), "s16", "mono")
            frame.sample_rate, frame.pts = 16_000, start
            sound.mux(stream.encode(frame))
        sound.mux(stream.encode(None))
    with pytest.raises(InputError, match=r"jump\.mkv: after 0\.064 s its sound jumps to 7200 s"):
        read_audio(path)
