"""Reading and writing of pictures, with provenance as metadata, and display transforms."""

import errno
import io
import json
import os
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by
from PIL import Image, PngImagePlugin

from usdface.core.arrays import ByteImage, Float32Array
from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.rates import LABEL
from usdface.core.replacing import replacing, write_bytes, write_text
from usdface.core.text import json_object, json_text
from usdface.core.version import __version__
from usdface.media.picture.canvas import scale_picture
from usdface.media.picture.color import bytes_from_linear, linear_from_srgb

_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff")

JPEG_QUALITY = 92
"""Of 100."""
_PNG_LEVEL = 4
"""Of 9: fast, and nearly as small."""
# Compression by OpenImageIO, lossless or nearly so.
_COMPRESSION = {".exr": "dwaa:45", ".tif": "zip", ".tiff": "zip"}
# Encoded in memory by Pillow. OpenImageIO's libraries mishandle failed writes: libpng ignores them,
# and libjpeg ends the process, which may be a DCC.
_IN_MEMORY: dict[str, Literal["jpeg", "png"]] = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
_MAX_JPEG = 65500
_MAX_JPEG_METADATA = 65000
"""Bytes; a JPEG segment has 65,533, including its header and the name of the software."""
_EXIF_DESCRIPTION, _EXIF_SOFTWARE = 0x010E, 0x0131
_MAX_METADATA = 16 << 20
_LEAST_ROOM = 64 << 10

MAX_VALUES = 1 << 29
"""Largest picture: 16,384 by 8,192 pixels of four channels."""
_DROP_BIT = 1 << 6


def write_measurements(
    paths: Sequence[Path],
    figures: Mapping[str, object],
    draw: Callable[[], ByteImage],
    *,
    metadata: Mapping[str, Any],
) -> None:
    """Write figures to the files that end in .json, and a picture of them to the others."""
    for path in paths:
        if path.suffix.lower() == ".json":
            write_text(path, json_text({**figures, "provenance": metadata}))
        else:
            write_image(path, draw(), metadata=metadata)


def write_image(
    path: Path,
    pixels: ByteImage,
    *,
    metadata: Mapping[str, Any] | None = None,
    timecode: str | None = None,
    rate: Fraction | None = None,
) -> None:
    """Write a picture in the format of its extension; an existing file is replaced atomically.

    `InputError` if the extension is unknown, the timecode of an EXR malformed, or the file cannot
    be written; an existing file is then unchanged.

    Parameters
    ----------
    path : Path
        ``.jpg``, ``.png``, ``.tif``, or ``.exr`` (linear half floats).
    pixels : (height, width, 3) uint8 array
        sRGB.
    metadata : mapping, optional
        Stored as JSON in ImageDescription, the one field common to the four formats.
    timecode : str, optional
        SMPTE timecode of the picture, ``HH:MM:SS:FF``; in EXR also as ``smpte:TimeCode``.
    rate : Fraction, optional
        Frames per second; in EXR also as ``FramesPerSecond``.
    """
    suffix = path.suffix.lower()
    if suffix not in _IMAGE_SUFFIXES:
        raise InputError(f"{path}: pictures end in {', '.join(_IMAGE_SUFFIXES)}; rename it")
    height, width = pixels.shape[:2]
    if suffix in (".jpg", ".jpeg") and max(height, width) > _MAX_JPEG:
        raise InputError(
            f"{path}: {width} × {height} pixels, JPEG ends at {_MAX_JPEG}; write .png or .exr"
        )
    description = _description(metadata or {}, timecode, rate)
    if suffix in _IN_MEMORY:
        write_bytes(path, _encoded(path, pixels, description))
        return
    with replacing(path) as temporary:
        spec = _specification(suffix, width, height, description, timecode, rate)
        linear = suffix == ".exr"
        data = linear_from_srgb(pixels / 255.0).astype(np.float32) if linear else pixels
        _see_that_there_is_room(path, temporary, data.nbytes + len(description))
        _write(path, temporary, spec, np.ascontiguousarray(data))


def read_image_metadata(path: Path) -> dict[str, Any]:
    """Return the metadata, timecode and rate stored by `write_image`; empty for other pictures."""
    check_may_open(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    source = oiio.ImageInput.open(str(path.absolute()))
    if source is None:
        raise InputError(f"{path}: cannot be read as a picture ({reason_of(oiio)}); write it again")
    try:
        spec = source.spec()
        caption = spec.getattribute("ImageDescription")  # of any type if damaged
        description = caption if isinstance(caption, str) else ""
        packed = spec.getattribute("smpte:TimeCode")
    except UnicodeDecodeError:  # a caption in another encoding
        description, packed = "", None
    finally:
        source.close()
    # A typed caption is not JSON: empty.
    metadata = json_object(description) if len(description) <= _MAX_METADATA else {}
    if "timecode" not in metadata and isinstance(packed, (tuple, list)):
        metadata["timecode"] = unpack_timecode(int(packed[0]))
    return metadata


_SOFTWARE = f"usdface {__version__}"


def _description(metadata: Mapping[str, Any], timecode: str | None, rate: Fraction | None) -> str:
    """Return a picture's metadata as JSON in ASCII, as EXIF requires."""
    fields = dict(metadata)
    if timecode is not None:
        fields["timecode"] = timecode
    if rate is not None:
        fields["rate"] = f"{rate.numerator}/{rate.denominator}"
    return json.dumps(fields, sort_keys=True, ensure_ascii=True)


def _encoded(file: Path, pixels: ByteImage, description: str) -> bytes:
    """Return a picture as the bytes of its file."""
    stream = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(pixels))
    if _IN_MEMORY[file.suffix.lower()] == "png":
        chunks = PngImagePlugin.PngInfo()
        chunks.add_text("Description", description)
        chunks.add_text("Software", _SOFTWARE)
        image.save(stream, "png", compress_level=_PNG_LEVEL, pnginfo=chunks)
        return stream.getvalue()
    if len(description) > _MAX_JPEG_METADATA:
        raise InputError(
            f"{file}: its provenance has {len(description)} bytes, more than the "
            f"{_MAX_JPEG_METADATA} of JPEG; write .png"
        )
    exif = Image.Exif()
    exif[_EXIF_DESCRIPTION], exif[_EXIF_SOFTWARE] = description, _SOFTWARE
    image.save(stream, "jpeg", quality=JPEG_QUALITY, exif=exif)
    return stream.getvalue()


def _specification(
    suffix: str,
    width: int,
    height: int,
    description: str,
    timecode: str | None,
    rate: Fraction | None,
) -> Any:
    spec = oiio.ImageSpec(width, height, 3, "half" if suffix == ".exr" else "uint8")
    spec["ImageDescription"] = description
    spec["Software"] = _SOFTWARE
    spec["oiio:ColorSpace"] = "lin_rec709" if suffix == ".exr" else "sRGB"
    spec["Compression"] = _COMPRESSION[suffix]
    if timecode is not None and suffix == ".exr":
        spec.attribute("smpte:TimeCode", oiio.TypeTimeCode, (pack_timecode(timecode), 0))
    if rate is not None and suffix == ".exr":
        fraction = (rate.numerator, rate.denominator)
        spec.attribute("FramesPerSecond", oiio.TypeRational, fraction)
    return spec


def _see_that_there_is_room(file: Path, temporary: Path, raw_bytes: int) -> None:
    """Refuse a full disk before writing starts."""
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        with temporary.open("wb") as stream:
            os.posix_fallocate(stream.fileno(), 0, raw_bytes + _LEAST_ROOM)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.EOPNOTSUPP):  # not supported by the file system
            return
        raise InputError(
            f"{file}: cannot be written ({error.strerror}): it may need "
            f"{(raw_bytes + _LEAST_ROOM) / 1e6:.1f} MB; free the disk, or write elsewhere"
        ) from error


def _write(file: Path, temporary: Path, spec: Any, data: np.ndarray) -> None:
    output = oiio.ImageOutput.create(str(temporary.absolute()))
    if output is None:
        raise InputError(f"{file}: OpenImageIO here cannot write it ({oiio.geterror()})")
    written = output.open(str(temporary.absolute()), spec) and output.write_image(data)
    reason = output.geterror()
    if not output.close() or not written:
        raise InputError(f"{file}: cannot be written ({reason or output.geterror()})")


def encode_image(
    pixels: ByteImage, kind: Literal["jpeg", "png"] = "jpeg", *, max_height: int | None = None
) -> bytes:
    """Encode an sRGB picture in memory, for pages; scale it down to `max_height` [pixels]."""
    height, width = pixels.shape[:2]
    scale = min((max_height or height) / height, 1.0)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    stream = io.BytesIO()
    image = Image.fromarray(scale_picture(np.ascontiguousarray(pixels), *size))
    if kind == "png":
        image.save(stream, "png")
    else:  # full chroma resolution, for thin coloured lines
        image.save(stream, "jpeg", quality=JPEG_QUALITY, subsampling=0)
    return stream.getvalue()


def read_picture(path: Path) -> ByteImage:
    """Read a picture as (height, width, 3) sRGB bytes, upright.

    The linear light of EXR is encoded, and its display window is read, black where it has no data.
    Of an EXR of several parts, the first with colours is read.
    """
    check_may_open(path)
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(f"{path}: cannot be read as a picture ({reason_of(oiio)})")
    linear = path.suffix.lower() == ".exr"
    parts = range(source.spec().get_int_attribute("oiio:subimages", 1) if linear else 0)
    names = [set(source.spec(part, 0).channelnames) for part in parts]
    source.seek_subimage(next((n for n, each in enumerate(names) if each >= {*"RGB"}), 0), 0)
    spec = source.spec()
    width, height = max(spec.width, spec.full_width), max(spec.height, spec.full_height)
    if width * height * spec.nchannels > MAX_VALUES:
        raise InputError(
            f"{path}: {width} × {height} with {spec.nchannels} channels is too large to be shown; "
            "write it smaller"
        )
    pixels = source.read_image(format="float" if linear else "uint8")
    reason = reason_of(source)
    source.close()
    if pixels is None:
        raise InputError(
            f"{path}: cannot be read as a picture ({reason}): it may be cut short or damaged; copy "
            "or write it again"
        )
    pixels = pixels[..., [0, 0, 0] if pixels.shape[2] < 3 else [0, 1, 2]]
    if not linear:
        shown = oiio.ImageBuf(np.ascontiguousarray(pixels))
        shown.orientation = spec.get_int_attribute("Orientation", 1)
        return np.asarray(oiio.ImageBufAlgo.reorient(shown).get_pixels(oiio.UINT8))
    window = np.zeros((spec.full_height, spec.full_width, 3), np.float32)
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    x0, x1 = np.clip((left, left + spec.width), 0, spec.full_width)
    y0, y1 = np.clip((top, top + spec.height), 0, spec.full_height)
    window[y0:y1, x0:x1] = pixels[y0 - top : y1 - top, x0 - left : x1 - left]
    return bytes_from_linear(window)


def reason_of(source: Any) -> str:
    """Return OpenImageIO's error in printable characters, which also stops it from printing it."""
    try:
        text = str(source.geterror())
    except UnicodeDecodeError:
        return "its header has bytes that are not text"
    return " ".join("".join(each if each.isprintable() else " " for each in text).split())


def pack_timecode(label: str) -> int:
    """Return a timecode as binary-coded decimal, hours in the highest byte.

    `label`: ``HH:MM:SS:FF``, or ``;`` before FF for drop-frame.
    """
    match = LABEL.match(label)
    if match is None or match[1] > "23" or match[2] > "59" or match[3] > "59" or match[5] > "39":
        raise InputError(f"timecode {label!r} is not hh:mm:ss:ff; correct it")
    packed = 0
    for group in (1, 2, 3, 5):
        packed = packed << 8 | int(match[group], 16)  # decimal digits, read as hexadecimal
    return packed | (_DROP_BIT if match[4] == ";" else 0)


def unpack_timecode(packed: int) -> str:
    """Return a packed timecode as text; flags other than drop-frame are ignored."""
    hours, minutes, seconds, frames = (
        packed >> shift & mask for shift, mask in ((24, 0x3F), (16, 0x7F), (8, 0x7F), (0, 0x3F))
    )
    mark = ";" if packed & _DROP_BIT else ":"
    return f"{hours:02x}:{minutes:02x}:{seconds:02x}{mark}{frames:02x}"


BUILT_IN = "ocio://default"
_RENDERED = "lin_rec709"
"""Alias of the renderer's colour space in configurations."""

DisplayView = Callable[[Float32Array], ByteImage]


def display_view(name: str | None) -> DisplayView:
    """Return the function from rendered light, (height, width, 3) linear Rec.709, to bytes.

    `name`: a view of the configuration's default display, or ``DISPLAY/VIEW``; None is sRGB. The
    configuration is that of ``$OCIO``, or else the one built into OpenColorIO.
    """
    if name is None:
        return bytes_from_linear
    where = os.environ.get("OCIO") or BUILT_IN
    config = oiio.ColorConfig(where)
    problem = reason_of(config)
    if problem or not config.getDisplayNames():
        raise InputError(f"{where}: no usable OpenColorIO configuration: {problem or 'no display'}")
    display, _, view = name.rpartition("/")
    display = display or config.getDefaultDisplayName()
    if display not in config.getDisplayNames():
        raise InputError(
            f"{where}: has no display {display!r}; it has {', '.join(config.getDisplayNames())}"
        )
    views = config.getViewNames(display)
    if view not in views:
        listed = ", ".join(map(repr, views))
        raise InputError(f"{where}: display {display!r} has no view {view!r}; it has {listed}")

    def show(light: Float32Array) -> ByteImage:
        source = oiio.ImageBuf(np.ascontiguousarray(light, np.float32))
        shown = oiio.ImageBufAlgo.ociodisplay(
            source, display, view, _RENDERED, "", True, False, "", "", where
        )
        if shown.has_error:
            raise InputError(f"{where}: cannot show linear Rec.709 by {view!r}: {reason_of(shown)}")
        pixels = np.asarray(shown.get_pixels(oiio.FLOAT), np.float32)
        return np.asarray(np.clip(pixels * 255 + 0.5, 0, 255), np.uint8)

    return show
