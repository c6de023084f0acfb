"""Write pictures that say where they come from, and read what they say."""

import errno
import json
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.core.replacing import replacing
from usdface.core.version import __version__
from usdface.media.picture.color import linear_from_srgb
from usdface.media.picture.read import reason_of
from usdface.media.picture.smpte import pack_timecode, unpack_timecode

_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff")

# What each format is written with: quality and a fast, lossless or nearly lossless packing.
_COMPRESSION = {
    ".jpg": "jpeg:92",
    ".jpeg": "jpeg:92",
    ".png": "zip:4",
    ".exr": "dwaa:45",
    ".tif": "zip",
    ".tiff": "zip",
}
# How a whole file ends: libpng does not tell when a full disk cut it short.
_ENDS = {".png": b"IEND\xaeB`\x82", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
_MAX_JPEG = 65500
_MAX_METADATA = 16 << 20
_LEAST_ROOM = 64 << 10


def write_image(
    path: Path | str,
    pixels: ByteImage,
    *,
    metadata: Mapping[str, Any] | None = None,
    timecode: str | None = None,
    rate: Fraction | None = None,
) -> None:
    """Write a picture in the format its name ends in; it replaces an old one only when complete.

    Parameters
    ----------
    path : Path
        ``.jpg``, ``.png``, ``.tif``, or ``.exr``: linear half floats.
    pixels : (height, width, 3) uint8 array
        sRGB.
    metadata : mapping, optional
        Kept as JSON in ImageDescription, the one field that all four formats keep.
    timecode : str, optional
        SMPTE time of the picture, ``HH:MM:SS:FF``; in EXR also as ``smpte:TimeCode``.
    rate : Fraction, optional
        Frames per second; in EXR also as ``FramesPerSecond``.

    Raises
    ------
    InputError
        If the extension is unknown, the time code malformed, the picture not of bytes, or the file
        cannot be written. An old file is left as it was.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in _COMPRESSION:
        raise InputError(f"{file}: pictures end in {', '.join(_IMAGE_SUFFIXES)}; rename it")
    image = np.asarray(pixels)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise InputError(
            f"{file}: a picture is (height, width, 3) uint8, got {image.shape} {image.dtype}"
        )
    height, width = image.shape[:2]
    if suffix in (".jpg", ".jpeg") and max(height, width) > _MAX_JPEG:
        raise InputError(
            f"{file}: {width} × {height} pixels, JPEG ends at {_MAX_JPEG}; write .png or .exr"
        )
    spec = _specification(suffix, width, height, metadata or {}, timecode, rate)
    linear = suffix == ".exr"
    data = linear_from_srgb(image / 255.0).astype(np.float32) if linear else image
    with replacing(file) as temporary:
        _see_that_there_is_room(file, temporary, data.nbytes + len(spec["ImageDescription"]))
        _write(file, temporary, spec, np.ascontiguousarray(data))


def read_image_metadata(path: Path | str) -> dict[str, Any]:
    """Return the metadata that `write_image` put in; empty if someone else made the picture.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict
        Also ``timecode`` and ``rate`` where they were given.

    Raises
    ------
    InputError
        If there is no such picture or it cannot be read.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: no such file; check the path")
    source = oiio.ImageInput.open(str(file.absolute()))
    if source is None:
        raise InputError(f"{file}: cannot be read as a picture ({reason_of(oiio)}); write it again")
    try:
        spec = source.spec()
        said = spec.getattribute("ImageDescription")  # in a damaged header of any type
        description = said if isinstance(said, str) else ""
        packed = spec.getattribute("smpte:TimeCode")
    except UnicodeDecodeError:  # a caption in another tool's letters
        description, packed = "", None
    finally:
        source.close()
    found: dict[str, Any] = {}
    if len(description) <= _MAX_METADATA:
        try:
            data = json.loads(description)
        except (ValueError, RecursionError):
            data = None  # a caption that someone typed
        if isinstance(data, dict):
            found = data
    if "timecode" not in found and isinstance(packed, (tuple, list)):
        found["timecode"] = unpack_timecode(int(packed[0]))
    return found


def _specification(
    suffix: str,
    width: int,
    height: int,
    metadata: Mapping[str, Any],
    timecode: str | None,
    rate: Fraction | None,
) -> Any:
    spec = oiio.ImageSpec(width, height, 3, "half" if suffix == ".exr" else "uint8")
    said = dict(metadata)
    if timecode is not None:
        said["timecode"] = timecode
    if rate is not None:
        said["rate"] = f"{rate.numerator}/{rate.denominator}"
    # ASCII, because EXIF promises no more; JSON escapes the rest.
    spec["ImageDescription"] = json.dumps(said, sort_keys=True, ensure_ascii=True)
    spec["Software"] = f"usdface {__version__}"
    spec["oiio:ColorSpace"] = "lin_rec709" if suffix == ".exr" else "sRGB"
    spec["Compression"] = _COMPRESSION[suffix]
    if timecode is not None:
        packed = pack_timecode(timecode)
        if suffix == ".exr":
            spec.attribute("smpte:TimeCode", oiio.TypeTimeCode, (packed, 0))
    if rate is not None and suffix == ".exr":
        fraction = (rate.numerator, rate.denominator)
        spec.attribute("FramesPerSecond", oiio.TypeRational, fraction)
    return spec


def _see_that_there_is_room(file: Path, temporary: Path, raw_bytes: int) -> None:
    """Refuse a full disk before a library meets it: libjpeg would end the process there."""
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        with temporary.open("wb") as stream:
            os.posix_fallocate(stream.fileno(), 0, raw_bytes + _LEAST_ROOM)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.EOPNOTSUPP):  # a file system that cannot promise
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
    end = _ENDS.get(file.suffix.lower(), b"")
    with temporary.open("rb") as stream:
        stream.seek(-min(len(end), stream.seek(0, os.SEEK_END)), os.SEEK_END)
        whole = stream.read() == end if end else True
    if not whole:
        raise InputError(
            f"{file}: cannot be written whole; is the disk full? Free it, or write elsewhere"
        )
