"""The report page: data, viewer and player of a performance in a single HTML file.

A page opened from disk cannot fetch, so it contains everything: arrays and movie as base64, scripts
and styles inline. Its content security policy allows its own script and style, by hash, only.
"""

import base64
import dataclasses
import hashlib
import html
import json
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.errors import InputError
from usdface.media.page.face_payload import (
    FacePayload,
    json_in_script,
    read_web_file,
    viewer_source,
)
from usdface.media.picture.color import bytes_from_linear, heat_ramp

WEIGHT_STEPS = 5000
"""Steps per 1 of weights: 0.0002 is 6 µm of a shape of 30 mm."""

_MARKER_STEPS = 100
"""Steps per millimetre of markers: a tenth of a capture's resolution, up to 327 mm from rest."""

_SCRIPTS = (
    "elements.js",
    "report_page.js",
    "tab_stops.js",
    "report_curves.js",
    "report_face.js",
    "report_notes.js",
    "report.js",
)
_PLACE = re.compile("@[A-Z]+@")

_ORIGIN = re.compile('<meta name="usdface" content="([^"]*)">')
_HEAD_CHARACTERS = 1 << 20
"""Characters at the start of a page that contain its provenance."""


@dataclass(frozen=True)
class WeightCurves:
    """One set of weights over the page's pictures."""

    name: str
    """Label on the page."""
    values: FloatArray
    """(pictures, shapes): NaN where missing."""
    kind: str = "solve"
    """``'solve'``, ``'edited'``, ``'baseline'``, ``'keys'`` or ``'version'``: its colour."""


@dataclass(frozen=True)
class Strip:
    """A quantity over time, such as the residual; NaN where missing."""

    name: str
    values: FloatArray
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class PageMarkers:
    """The performer's markers on the character."""

    names: tuple[str, ...]
    rest: FloatArray
    """(markers, 3): positions on the rig at rest [mm]."""
    motion: FloatArray
    """(pictures, markers, 3): displacement of the markers from rest; NaN if occluded [mm]."""
    key_deltas: FloatArray
    """(keys, markers, 3): displacement of the positions by each key of ``Deformer(rig).shapes``
    [mm]."""
    lines: IntArray
    """(lines, 2): markers joined by lines."""


@dataclass(frozen=True)
class PageHeat:
    """The heat map of the face: a value per region, or the distance between two sets of curves."""

    name: str
    high_mm: float
    """Value of the last colour [mm]."""
    against: int | None = None
    """Index of the curves to which the distance is shown."""
    regions: tuple[str, ...] = ()
    values: FloatArray | None = None
    """(pictures, regions) [mm]"""


@dataclass(frozen=True)
class PageCommands:
    """Command lines for tuning a frame of the page."""

    add: str = ""
    tune: str = ""
    """`add`, `tune`: empty if the references are unknown."""
    pairs: tuple[int, ...] = ()
    """Frames that are references."""


@dataclass(frozen=True)
class PageNotes:
    """Notes shown initially, and what identifies the performance in saved notes."""

    performance: str = ""
    take: str = ""
    version: str = ""
    file: str = "notes.json"
    """Default name of the saved file."""
    notes: tuple[Mapping[str, Any], ...] = ()
    """Fields of `usdface.specs.notes.ReviewNote`."""


@dataclass(frozen=True)
class Listing:
    """A table below the player; rows link to frames."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    frames: tuple[int | None, ...] = ()


@dataclass(frozen=True)
class PagePicture:
    """A picture below the player."""

    title: str
    alt: str
    """Alternative text."""
    data: bytes
    kind: str
    """Such as ``'image/png'``."""


@dataclass(frozen=True)
class ReviewPage:
    """Content of a page."""

    title: str
    verdict: tuple[str, str, str]
    """``'good'``, ``'check'`` or ``'bad'``; the reason; and what to do, or empty."""
    facts: tuple[str, ...]
    rate: float
    """Pictures per second of the take; the movie may have fewer."""
    frames: Sequence[int]
    """Frame number of each picture."""
    timecodes: Sequence[str]
    """One per picture, or empty."""
    shapes: tuple[str, ...]
    """Names of the columns of all curves."""
    regions: tuple[str, ...]
    """Region of each shape."""
    curves: tuple[WeightCurves, ...]
    """The first set poses the face."""
    strips: tuple[Strip, ...]
    worst: tuple[tuple[int, str, str], ...]
    """tuple of (picture, region, reason): to review first, in this order."""
    listings: tuple[Listing, ...]
    face: FacePayload
    """Shapes are matched by name."""
    movie: bytes = b""
    """Video synchronous with the pictures, or empty."""
    movie_type: str = "video/mp4"
    """Such as ``'video/mp4'``."""
    pictures: tuple[PagePicture, ...] = ()
    """Such as a contact sheet."""
    spoken: Sequence[str] = ()
    """Phone or word in each picture, or empty."""
    origin: Mapping[str, object] | None = None
    """Provenance."""
    markers: PageMarkers | None = None
    transforms: FloatArray | None = None
    """(pictures, parts, 3, 4): transforms by joints and Xforms of the parts of `face` [mm]; None if
    none moves."""
    moves_as_one: bool = False
    """Whether one part carries the whole face and the markers."""
    heat: PageHeat | None = None
    """Heat map, if any."""
    left_out: tuple[str, ...] = ()
    """Shapes of gaze and tongue, ignored in distances of the skin."""
    notes: PageNotes = PageNotes()
    commands: PageCommands = PageCommands()


def read_page_origin(path: Path) -> str:
    """Return the provenance of a page as JSON; empty if it has none."""
    try:
        with path.open(encoding="utf-8") as stream:
            origin = _ORIGIN.search(stream.read(_HEAD_CHARACTERS))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a page: {error}") from error
    return html.unescape(origin[1]) if origin else ""


def build_page(page: ReviewPage) -> str:
    """Return the page as HTML."""
    style = read_web_file("report.css").decode("utf-8").replace("@RAMP@", _ramp())
    script = viewer_source(*_SCRIPTS)
    parts = {
        "@TITLE@": html.escape(page.title),
        "@LEVEL@": page.verdict[0],
        "@VERDICT@": html.escape(page.verdict[1]),
        "@TODO@": html.escape(f"To do: {page.verdict[2]}" if page.verdict[2] else ""),
        "@FACTS@": "".join(f"<li>{html.escape(fact)}</li>" for fact in page.facts),
        "@POLICY@": "default-src 'none'; img-src data: blob:; media-src blob:; base-uri 'none'; "
        f"form-action 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'",
        "@ORIGIN@": html.escape(json.dumps(page.origin, ensure_ascii=False) if page.origin else ""),
        "@STYLE@": style,
        "@DATA@": json_in_script(_data(page)),
        "@FACEHEADER@": page.face.header_json(),
        "@FACE@": page.face.data_base64(),
        "@CURVES@": "".join(_arrays(page)),
        "@MOVIE@": _base64(page.movie),
        "@PICTURES@": "".join(_picture(each) for each in page.pictures),
        "@LISTINGS@": "".join(_listing(each) for each in page.listings),
        "@SCRIPT@": script,
    }
    text = read_web_file("report.html").decode("utf-8")
    # One pass, so that placeholders within the data are not replaced.
    return _PLACE.sub(lambda place: parts[place[0]], text)


def _data(page: ReviewPage) -> Mapping[str, Any]:
    labels = list(dict.fromkeys(page.spoken))
    place = index_of(labels)
    # Shape errors are relative to the first of these kinds.
    kinds = [curve.kind for curve in page.curves]
    ranked = (kinds.index(kind) for kind in ("keys", "version", "baseline") if kind in kinds)
    return {
        "labels": labels,
        "spoken": [place[label] for label in page.spoken],
        "rate": page.rate,
        "frames": [int(frame) for frame in page.frames],
        "timecodes": list(page.timecodes),
        "shapes": list(page.shapes),
        "regions": list(page.regions),
        "steps": WEIGHT_STEPS,
        "curves": [{"name": curve.name, "kind": curve.kind} for curve in page.curves],
        "compared": next(ranked, None),
        "ramp": np.round(heat_ramp(np.linspace(0, 1, 5)), 4).tolist(),
        "heat": _heat(page.heat),
        "leftOut": list(page.left_out),
        "markers": _markers(page.markers),
        "transforms": page.transforms is not None,
        "movesAsOne": page.moves_as_one,
        "performance": page.notes.performance,
        "take": page.notes.take,
        "version": page.notes.version,
        "notesFile": page.notes.file,
        "notes": list(page.notes.notes),
        "commands": dataclasses.asdict(page.commands),
        "strips": [
            {
                "name": strip.name,
                "low": strip.low,
                "high": strip.high,
                "unit": strip.unit,
                "values": [
                    round(value, 4) if np.isfinite(value) else None
                    for value in strip.values.tolist()
                ],
            }
            for strip in page.strips
        ],
        "worst": [
            {"picture": picture, "region": region, "reason": reason}
            for picture, region, reason in page.worst
        ],
        "movie": page.movie_type if page.movie else "",
    }


def _heat(heat: PageHeat | None) -> Mapping[str, Any] | None:
    if heat is None:
        return None
    scale = {"name": heat.name, "high": heat.high_mm}
    if heat.values is None:
        return {**scale, "against": heat.against}
    values = np.round(np.nan_to_num(heat.values.T), 2).ravel().tolist()
    return {**scale, "regions": list(heat.regions), "values": values}


def _markers(markers: PageMarkers | None) -> Mapping[str, Any] | None:
    if markers is None:
        return None
    return {
        "names": list(markers.names),
        "rest": np.round(markers.rest, 3).ravel().tolist(),
        "lines": markers.lines.ravel().tolist(),
        "steps": _MARKER_STEPS,
    }


def _arrays(page: ReviewPage) -> Iterator[str]:
    """Yield curves and markers as ``<script>`` elements of deflated arrays."""
    for index, curve in enumerate(page.curves):
        yield _array(f"curve-{index}", _steps(curve.values.T, WEIGHT_STEPS))
    if page.transforms is not None:
        yield _array("transforms", page.transforms.astype("<f4"))
    if page.markers is not None:
        motion = _steps(page.markers.motion, _MARKER_STEPS).reshape(len(page.frames), -1)
        # Differences wrap modulo the type; so do the sums that restore them.
        yield _array("markerMotion", np.diff(motion, axis=0, prepend=np.zeros_like(motion[:1])))
        yield _array("markerDeltas", page.markers.key_deltas.astype("<f4"))


def _steps(values: FloatArray, per_unit: int) -> NDArray[np.int16]:
    """Return values as 16-bit steps; the lowest number is NaN."""
    most = np.iinfo(np.int16).max
    steps = np.clip(np.round(np.nan_to_num(values) * per_unit), -most, most).astype("<i2")
    steps[np.isnan(values)] = np.iinfo(np.int16).min
    return steps


def _array(name: str, values: NDArray[Any]) -> str:
    packed = _base64(zlib.compress(np.ascontiguousarray(values).tobytes(), 6))
    return f'<script type="text/plain" id="{name}">{packed}</script>\n'


def _ramp() -> str:
    """Return the colours of the ramp in CSS."""
    colors = bytes_from_linear(heat_ramp(np.linspace(0, 1, 9))).tolist()
    return ", ".join(f"rgb({red} {green} {blue})" for red, green, blue in colors)


def _picture(picture: PagePicture) -> str:
    source = f"data:{picture.kind};base64,{_base64(picture.data)}"
    return (
        f'<section class="picture"><h2>{html.escape(picture.title)}</h2>'
        f'<button title="Show it in full, or fitted" aria-expanded="false">'
        f'<img alt="{html.escape(picture.alt)}" src="{source}"></button></section>'
    )


def _listing(listing: Listing) -> str:
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in listing.head)
    body = []
    frames = listing.frames or (None,) * len(listing.rows)
    for row, frame in zip(listing.rows, frames, strict=True):
        cells = [html.escape(cell) for cell in row]
        if frame is not None:
            cells[0] = f'<a href="#{frame}">{cells[0]}</a>'
        body.append(
            f'<tr><th scope="row">{cells[0]}</th>'
            + "".join(f"<td>{cell}</td>" for cell in cells[1:])
            + "</tr>"
        )
    title = html.escape(listing.title)
    return (
        f"<section><table><caption><h2>{title}</h2></caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></section>"
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
