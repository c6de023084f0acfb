import errno
import io
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from PIL import Image

from usdface.core import replacing
from usdface.core.errors import InputError
from usdface.media.picture.image import (
    encode_image,
    pack_timecode,
    read_image_metadata,
    read_picture,
    unpack_timecode,
    write_image,
)

PICTURE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)


def read_pixels(path: Path) -> np.ndarray:
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels("float"))


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "png", "exr", "tif", "tiff"])
def test_metadata_survives_in_every_format(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sheet.{suffix}"
    said = {"performer": "Jürgen Groß", "frames": [1001, 1105], "inputs": {"take.usda": "ab" * 32}}
    write_image(path, PICTURE, metadata=said, timecode="01:02:03:14", rate=Fraction(24000, 1001))
    assert read_image_metadata(path) == said | {"timecode": "01:02:03:14", "rate": "24000/1001"}


@pytest.mark.parametrize("suffix", ["jpg", "png", "exr", "tif"])
def test_a_picture_that_the_disk_cut_short_takes_no_ones_place(tmp_path: Path, suffix: str) -> None:
    resource = pytest.importorskip("resource")
    path = tmp_path / f"sheet.{suffix}"
    picture = np.random.default_rng(0).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    write_image(path, picture)
    whole = path.read_bytes()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        for size in (1, len(whole) // 2, len(whole) * 9 // 10):
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
            with pytest.raises(InputError, match=r"sheet.*cannot be written"):
                write_image(path, 255 - picture)
            assert path.read_bytes() == whole
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_lossless_formats_keep_every_pixel(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sheet.{suffix}"
    write_image(path, PICTURE)
    np.testing.assert_array_equal(np.round(read_pixels(path) * 255), PICTURE)


def test_exr_is_linear_and_carries_time_code_and_rate(tmp_path: Path) -> None:
    path = tmp_path / "sheet.exr"
    grey = np.full((16, 16, 3), 188, np.uint8)  # sRGB 188 is half the light
    write_image(path, grey, timecode="01:02:03:14", rate=Fraction(24))
    assert read_pixels(path).mean() == pytest.approx(0.503, abs=0.003)
    spec = oiio.ImageBuf(str(path)).spec()
    packed, _ = spec.getattribute("smpte:TimeCode")
    assert packed == 0x01020314
    assert spec.getattribute("oiio:ColorSpace") in ("lin_rec709", "lin_rec709_scene", "Linear")


@pytest.mark.parametrize("label", ["00:00:00:00", "23:59:07:29", "10:00:00;28"])
def test_packed_timecode_unpacks_to_itself(label: str) -> None:
    assert unpack_timecode(pack_timecode(label)) == label


def test_picture_of_someone_else_says_nothing(tmp_path: Path) -> None:
    path = tmp_path / "holiday.png"
    buffer = oiio.ImageBuf(PICTURE)
    buffer.specmod()["ImageDescription"] = "[the sea, and {me}"
    buffer.write(str(path))
    assert read_image_metadata(path) == {}


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("sheet.bmpx", {}, "pictures end in"),
        ("nowhere/sheet.png", {}, "does not exist"),
        ("sheet.exr", {"timecode": "1:2:3"}, "not hh:mm:ss:ff"),
        ("sheet.jpg", {"pixels": np.zeros((70000, 2, 3), np.uint8)}, "JPEG ends at"),
    ],
    ids=["extension", "folder", "timecode", "too tall for JPEG"],
)
def test_picture_that_cannot_be_written_says_why(
    tmp_path: Path, name: str, arguments: dict, message: str
) -> None:
    pixels = arguments.pop("pixels", PICTURE)
    with pytest.raises(InputError, match=message):
        write_image(tmp_path / name, pixels, **arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_any_failed_write_is_an_error_and_not_the_end_of_the_process(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / f"full.{suffix}"
    link.symlink_to("/dev/full")
    monkeypatch.setattr(replacing, "replacing", lambda path: nullcontext(link))
    with pytest.raises(InputError, match=r"sheet.*cannot be written \(No space left"):
        write_image(tmp_path / f"sheet.{suffix}", PICTURE)


def test_more_metadata_than_jpeg_holds_is_refused_by_name(tmp_path: Path) -> None:
    said = {"inputs": {f"take.{number}.usda": "ab" * 32 for number in range(1000)}}
    with pytest.raises(InputError, match=r"sheet\.jpg: .* bytes, more than the 65000 of JPEG"):
        write_image(tmp_path / "sheet.jpg", PICTURE, metadata=said)
    write_image(tmp_path / "sheet.png", PICTURE, metadata=said)
    assert read_image_metadata(tmp_path / "sheet.png") == said


def no_room(*_: object) -> None:
    raise OSError(errno.ENOSPC, "no room")


def test_failing_write_leaves_the_old_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "sheet.png"
    write_image(path, PICTURE, metadata={"version": 1})
    before = path.read_bytes()
    monkeypatch.setattr(Path, "write_bytes", no_room)
    with pytest.raises(InputError, match=r"sheet\.png"):
        write_image(path, PICTURE, metadata={"version": 2})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.png"]


def test_broken_picture_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "broken.png"
    path.write_bytes(b"not a picture")
    with pytest.raises(InputError, match=r"broken\.png"):
        read_image_metadata(path)


def decode(data: bytes) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(data)))


def gradient(height: int, width: int) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width]
    red, green = 255 * rows / height, 255 * columns / width
    return np.stack([red, green, np.full_like(red, 90)], axis=-1).astype(np.uint8)


def test_a_picture_comes_back_in_its_colours() -> None:
    picture = gradient(101, 77)
    back = decode(encode_image(picture))
    assert back.shape == picture.shape
    assert np.abs(back.astype(int) - picture).mean() < 2.5


def test_a_tall_picture_is_made_smaller_and_keeps_its_proportions() -> None:
    assert decode(encode_image(gradient(600, 300), max_height=200)).shape == (200, 100, 3)


def test_png_in_memory_keeps_every_pixel() -> None:
    np.testing.assert_array_equal(decode(encode_image(PICTURE, "png")), PICTURE)


def test_a_picture_of_a_phone_is_read_upright(tmp_path: Path) -> None:
    upright = np.zeros((24, 16, 3), np.uint8)
    upright[:8, :8], upright[16:, 8:] = 255, 128
    as_stored = {1: upright, 3: upright[::-1, ::-1], 4: upright[::-1], 8: np.rot90(upright, -1)}
    as_stored |= {2: upright[:, ::-1], 5: upright.swapaxes(0, 1), 6: np.rot90(upright)}
    as_stored[7] = upright[::-1, ::-1].swapaxes(0, 1)
    for orientation, stored in as_stored.items():
        exif = Image.Exif()
        exif[0x0112] = orientation
        path = tmp_path / f"{orientation}.jpg"
        Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif, quality=100)
        read = read_picture(path)
        assert read.shape == upright.shape
        np.testing.assert_allclose(read.astype(int), upright, atol=12, err_msg=str(orientation))


def test_the_part_of_an_exr_with_colours_is_read(tmp_path: Path) -> None:
    path = str(tmp_path / "parts.exr")
    depth, beauty = oiio.ImageSpec(8, 6, 1, "half"), oiio.ImageSpec(8, 6, 3, "half")
    depth.channelnames, depth["name"], beauty["name"] = ("Z",), "depth", "rgba"
    output = oiio.ImageOutput.create(path)
    assert output.open(path, (depth, beauty))
    output.write_image(np.full((6, 8, 1), 0.9, np.float32))
    assert output.open(path, beauty, "AppendSubimage")
    output.write_image(np.tile(np.array([1, 0, 0], np.float32), (6, 8, 1)))
    output.close()
    np.testing.assert_array_equal(read_picture(Path(path)), np.tile([255, 0, 0], (6, 8, 1)))
