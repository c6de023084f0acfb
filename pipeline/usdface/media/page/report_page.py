"""A performance as one page that opens from disk: data, viewer and player in a single file.

A page opened as a file may fetch nothing, so all that it shows is inside it: arrays as base64, the
movie as a blob, scripts and styles in place. Its policy allows its own script, by hash, and nothing
else: no network, no evaluation, no frames.
"""

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray, index_of
from usdface.core.errors import InputError
from usdface.media.page.face_payload import FacePayload, read_web_file, viewer_source

WEIGHT_STEPS = 5000
"""Weights are told in steps of 0.0002: a shape of 30 mm then moves in steps of 6 micrometres."""
_LARGEST = 32767 / WEIGHT_STEPS
_PLACE = re.compile("@[A-Z]+@")

_ORIGIN = re.compile('<meta name="usdface" content="([^"]*)">')
_HEAD_CHARACTERS = 1 << 20
"""Where what made a page is looked for: it stands before everything else."""


@dataclass(frozen=True)
class WeightCurves:
    """One set of weights over the page's pictures."""

    name: str
    """``'solve'``, ``'edited'``, ``'baseline'``, ``'keys'`` …"""
    values: FloatArray
    """(pictures, shapes): NaN where there is nothing."""


@dataclass(frozen=True)
class Strip:
    """A figure over time, such as the residual; NaN where there is none."""

    name: str
    values: FloatArray
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Listing:
    """A table below the player: its head, its rows, and frames that rows link to."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    frames: tuple[int | None, ...] = ()


@dataclass(frozen=True)
class PagePicture:
    """A picture below the player."""

    title: str
    alt: str
    """What it shows, for those who do not see it."""
    data: bytes
    kind: str
    """Such as ``'image/png'``."""


@dataclass(frozen=True)
class ReviewPage:
    """All that is in a page."""

    title: str
    verdict: tuple[str, str, str]
    """``'good'``, ``'check'`` or ``'bad'``; why; and what to do, or nothing."""
    facts: tuple[str, ...]
    rate: float
    """Pictures per second: those of the take. The movie may have fewer."""
    frames: Sequence[int]
    """Frame number of each picture."""
    timecodes: Sequence[str]
    """As many, or none."""
    shapes: tuple[str, ...]
    """Names of the columns of all curves."""
    regions: tuple[str, ...]
    """Region of each shape."""
    curves: tuple[WeightCurves, ...]
    """The first poses the face."""
    strips: tuple[Strip, ...]
    worst: tuple[tuple[int, str, str], ...]
    """tuple of (picture, region, reason): moments to review first, the worst first."""
    listings: tuple[Listing, ...]
    face: FacePayload
    """Its shapes are matched by name."""
    movie: bytes = b""
    """Video on the clock of the pictures; empty without."""
    movie_type: str = "video/mp4"
    """Such as ``'video/mp4'``."""
    pictures: tuple[PagePicture, ...] = ()
    """Such as a contact sheet."""
    said: Sequence[str] = ()
    """What is said in each picture; or none."""
    origin: Mapping[str, object] | None = None
    """What made it, for those who make it again."""


def read_page_origin(path: Path) -> str:
    """Return what a page says of its making, as JSON; empty where it says nothing.

    Raises
    ------
    InputError
        If the file cannot be read, or is no text.
    """
    try:
        with path.open(encoding="utf-8") as stream:
            found = _ORIGIN.search(stream.read(_HEAD_CHARACTERS))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no page that can be read: {error}") from error
    return html.unescape(found[1]) if found else ""


def build_page(page: ReviewPage) -> str:
    """Return the page as HTML."""
    style = read_web_file("report.css").decode("utf-8")
    script = f"{viewer_source()}\n{read_web_file('report.js').decode('utf-8')}"
    parts = {
        "@TITLE@": html.escape(page.title),
        "@LEVEL@": page.verdict[0],
        "@VERDICT@": html.escape(page.verdict[1]),
        "@TODO@": html.escape(f"To do: {page.verdict[2]}" if page.verdict[2] else ""),
        "@FACTS@": "".join(f"<li>{html.escape(fact)}</li>" for fact in page.facts),
        "@POLICY@": _policy(script, style),
        "@ORIGIN@": html.escape(json.dumps(page.origin, ensure_ascii=False) if page.origin else ""),
        "@STYLE@": style,
        "@DATA@": _in_script(_data(page)),
        "@FACEHEADER@": page.face.header_json(),
        "@FACE@": page.face.data_base64(),
        "@CURVES@": "".join(_curves(each) for each in page.curves),
        "@MOVIE@": _base64(page.movie),
        "@PICTURES@": "".join(_picture(each) for each in page.pictures),
        "@LISTINGS@": "".join(_listing(each) for each in page.listings),
        "@SCRIPT@": script,
    }
    text = read_web_file("report.html").decode("utf-8")
    # One pass, so that nothing inside the data is taken for a place to fill.
    return _PLACE.sub(lambda place: parts[place[0]], text)


def _data(page: ReviewPage) -> Mapping[str, Any]:
    labels = list(dict.fromkeys(page.said))
    place = index_of(labels)
    return {
        "labels": labels,
        "said": [place[label] for label in page.said],
        "rate": page.rate,
        "frames": [int(frame) for frame in page.frames],
        "timecodes": list(page.timecodes),
        "shapes": list(page.shapes),
        "regions": list(page.regions),
        "steps": WEIGHT_STEPS,
        "curves": [curve.name for curve in page.curves],
        "strips": [
            {
                "name": strip.name,
                "low": strip.low,
                "high": strip.high,
                "unit": strip.unit,
                "values": [
                    None if not np.isfinite(value) else round(value, 4)
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


def _curves(curve: WeightCurves) -> str:
    """Return weights as 16-bit steps, shape by shape, deflated; the lowest number is no value."""
    limited = np.clip(np.nan_to_num(curve.values.T), -_LARGEST, _LARGEST)
    steps = np.round(limited * WEIGHT_STEPS).astype("<i2")
    steps[np.isnan(curve.values.T)] = np.iinfo(np.int16).min
    packed = _base64(zlib.compress(np.ascontiguousarray(steps).tobytes(), 9))
    return f'<script type="text/plain" id="curve-{html.escape(curve.name)}">{packed}</script>\n'


def _picture(picture: PagePicture) -> str:
    source = f"data:{picture.kind};base64,{_base64(picture.data)}"
    return (
        f'<section class="picture"><h2>{html.escape(picture.title)}</h2>'
        f'<img alt="{html.escape(picture.alt)}" src="{source}"></section>'
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
    return (
        f"<section><h2>{html.escape(listing.title)}</h2><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></section>"
    )


def _policy(script: str, style: str) -> str:
    return (
        "default-src 'none'; img-src data: blob:; media-src blob:; base-uri 'none'; "
        f"form-action 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'"
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _in_script(data: Mapping[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
