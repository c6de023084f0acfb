"""Detection of a capture's format from its content, and reading."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdface.capture.c3d import is_c3d, read_c3d_take
from usdface.capture.face_cap import is_face_cap, read_face_cap
from usdface.capture.ifacialmocap import is_ifacialmocap, read_ifacialmocap
from usdface.capture.live_link_csv import is_live_link_csv, read_live_link_csv
from usdface.capture.marker_csv import is_marker_csv, read_marker_csv
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.motive_csv import is_motive_csv, read_motive_csv
from usdface.capture.openface_csv import is_openface_csv, read_openface_csv
from usdface.capture.trc import is_trc, read_trc
from usdface.capture.vicon_csv import is_vicon_csv, read_vicon_csv
from usdface.capture.weight_samples import is_weight_csv, is_weight_json, is_weight_npy
from usdface.capture.weight_table import read_weight_take
from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.text import shell_word

_HEAD_BYTES = 64 << 10
VIDEO_SUFFIXES = (".mov", ".mp4", ".mxf", ".mkv", ".avi", ".webm", ".m4v")
_EXPORTS = dict.fromkeys(
    (".ma", ".mb", ".fbx", ".bvh", ".blend", ".abc"),
    "is a scene, which is not read: export the markers from it as USD (points, locators or joints) "
    "or C3D, and ingest that",
) | dict.fromkeys(
    VIDEO_SUFFIXES,
    "is a movie, which holds no markers: track the face in it with `usdface track {name} --out "
    "{take}`, or ingest the capture that it was filmed with, and the movie as --video",
)
"""What to do with files that are often tried, by how their names end."""

_TRACK_IT = "track the face in the movie itself with `usdface track`"
_LANDMARKS: tuple[tuple[re.Pattern[bytes], str], ...] = (
    (
        re.compile(rb'\s*[\[{].*"(?:face_?)?landmarks"', re.DOTALL | re.IGNORECASE),
        "holds landmarks in JSON, in shares of a picture whose size it does not state: "
        f"{_TRACK_IT}, or write them as a table in mm, marker-csv",
    ),
    (
        re.compile(rb"[^\n]*\bx_?0\b[^\n]*\by_?4[67]7\b", re.IGNORECASE),
        "holds MediaPipe's landmarks, in shares of a picture whose size it does not state: "
        f"{_TRACK_IT}, or write them as a table in mm, marker-csv",
    ),
    (
        re.compile(
            rb"[^\n]*\bx_?0\b[^\n]*\by_?67\b|version:\s*1\s+n_points:\s*68\b", re.IGNORECASE
        ),
        "holds 68 landmarks in the picture (dlib, iBUG), without depth: "
        f"{_TRACK_IT}, or run OpenFace's FeatureExtraction with -3Dfp",
    ),
)
"""Landmarks of other trackers that are not read, by their first bytes."""
_SCORES = re.compile(
    rb'"(categoryName|category_name|(face_?)?blendshapes"\s*:(?!\s*\[[\s\[\]]*\]))', re.IGNORECASE
)
"""JSON keys of weights, other than an empty list of them."""
_FRAME_LOG = (
    "is the frame log of Live Link Face, without weights: ingest the CSV of weights in its folder, "
    f"with the MOV as --video; without such a CSV, {_TRACK_IT}"
)


@dataclass(frozen=True)
class CaptureFormat:
    """One format: how to recognise it and how to read it."""

    name: str
    description: str
    recognise: Callable[[bytes], bool]
    read: Callable[[Path, CaptureOptions], Capture]


FORMATS: tuple[CaptureFormat, ...] = (
    CaptureFormat("c3d", "C3D, optical capture", is_c3d, read_c3d_take),
    CaptureFormat("trc", "TRC, Motion Analysis and OpenSim", is_trc, read_trc),
    CaptureFormat("motive-csv", "CSV of OptiTrack Motive", is_motive_csv, read_motive_csv),
    CaptureFormat("vicon-csv", "CSV of Vicon", is_vicon_csv, read_vicon_csv),
    CaptureFormat("live-link-csv", "CSV of Live Link Face", is_live_link_csv, read_live_link_csv),
    CaptureFormat("face-cap", "text of Face Cap", is_face_cap, read_face_cap),
    CaptureFormat(
        "ifacialmocap", "saved stream of iFacialMocap", is_ifacialmocap, read_ifacialmocap
    ),
    CaptureFormat("openface-csv", "CSV of OpenFace", is_openface_csv, read_openface_csv),
    CaptureFormat(
        "marker-csv", "CSV of frame, time_s, NAME.x, NAME.y, NAME.z", is_marker_csv, read_marker_csv
    ),
    CaptureFormat("weights-npy", "NumPy matrix of weights", is_weight_npy, read_weight_take),
    CaptureFormat("weights-json", "JSON of weights", is_weight_json, read_weight_take),
    CaptureFormat(
        "weights-csv",
        "CSV of frame or time, then a column per shape",
        is_weight_csv,
        read_weight_take,
    ),
)
"""In the order in which they are tried: the most specific first."""


def read_capture(path: Path, *, format: str | None = None, **stated: Any) -> Capture:
    """Read any capture file as a take in millimetres, Y up.

    Parameters
    ----------
    format : str, optional
        Name of one of `FORMATS`; default: detected from the content, whatever the extension.
    **stated
        Fields of `CaptureOptions`.
    """
    path = Path(path)
    options = CaptureOptions(**stated | {"rigid": tuple(stated.get("rigid", ()))})
    try:
        chosen = _named_format(format) if format is not None else recognise_format(path)
        return chosen.read(path, options)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}; check the path and its permissions"
        ) from error


def visible_files(folder: Path) -> list[Path]:
    """Return the files of a folder by name, without hidden ones."""
    files = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(path for path in files if path.is_file())


def recognise_format(path: Path) -> CaptureFormat:
    """Return the format of a file, from its first bytes."""
    check_may_open(path)
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    advice = _EXPORTS.get(path.suffix.lower())
    if advice is not None:
        name, take = shell_word(path.name), shell_word(f"{path.stem}.take.usda")
        raise InputError(f"{path} {advice.format(name=name, take=take)}")
    if path.name.lower().endswith("frame_log.csv"):
        raise InputError(f"{path} {_FRAME_LOG}")
    if not head:
        raise InputError(f"{path}: the file is empty (0 bytes); copy or export the capture again")
    refused = next((advice for pattern, advice in _LANDMARKS if pattern.match(head)), None)
    if _SCORES.search(head):
        refused = None  # of landmarks with weights, the weights are read
    for candidate in FORMATS:
        table = candidate.name.startswith("weights-")
        if not (table and refused) and candidate.recognise(head):
            return candidate
    if refused is not None:
        raise InputError(f"{path} {refused}")
    raise InputError(
        f"{path}: not a known capture format (it begins with {_readable(head)}); known are "
        f"{_known_formats()}; export one of these, or name it with --format"
    )


def _readable(head: bytes) -> str:
    """Return the first characters of a file in printable form."""
    text = head[:24].decode("ascii", errors="replace")
    return repr(text.replace("\ufffd", "?"))


def _named_format(name: str) -> CaptureFormat:
    for candidate in FORMATS:
        if candidate.name == name.lower():
            return candidate
    raise InputError(f"capture format {name!r} is not known; known are {_known_formats()}")


def _known_formats() -> str:
    named = (f"{candidate.name} ({candidate.description})" for candidate in FORMATS)
    return ", ".join((*named, "and USD (.usd, .usda, .usdc, .usdz)"))
