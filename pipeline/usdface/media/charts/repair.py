"""Chart of repaired samples over a take, by marker and kind of repair."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, longest_run
from usdface.core.errors import InputError
from usdface.core.text import pluralize
from usdface.media.picture.canvas import fill_box, new_picture
from usdface.media.picture.color import DIM, LANE, PAGE, SOFT, Color
from usdface.media.picture.error_strip import draw_frame_axis
from usdface.media.picture.sheet import draw_header, draw_verdict
from usdface.media.picture.sheet_layout import VERDICT_SCALE
from usdface.media.picture.text import TextStyle, draw_text, text_width

_PAGE_WIDTH = 1600
REPAIR_MARGIN = 28
MARKER_LABEL_WIDTH = 190
_ROW_HEIGHT = 17
HEAD_HEIGHT = 190
"""Height of title, facts, verdict and colour key [pixels]."""
_VERDICT_HEIGHT = 34
MOST_LANES = 120
"""Lanes of single markers, those with the most repairs."""
_LABEL_STYLE = TextStyle(size=14, color=SOFT)
_NOTE_STYLE = TextStyle(size=16, color=DIM)


@dataclass(frozen=True)
class RepairKind:
    """One kind of repair."""

    label: str
    """In the key."""
    color: Color
    """sRGB bytes."""
    where: BoolArray
    """(frames, markers)"""


def draw_repairs(
    names: Sequence[str],
    kinds: Sequence[RepairKind],
    *,
    title: str,
    verdict: tuple[str, str],
    facts: Sequence[str],
    first_frame: int,
    least_frames: int = 1,
) -> ByteImage:
    """Draw a lane for each marker with long repairs, sorted by number of repairs.

    Other markers, and those beyond `MOST_LANES`, share the last lane. A column is coloured if any
    of its frames was repaired, so that single samples are visible.

    Parameters
    ----------
    names : sequence of str
        One per marker.
    kinds : sequence of RepairKind
        Later ones are drawn over earlier ones.
    title, facts
        Written at the top.
    verdict : tuple of str
        ``'good'``, ``'check'`` or ``'bad'``, and the sentence.
    first_frame : int
        Frame number of the first row of each kind.
    least_frames : int
        Length of a repair [frames] from which a marker has its own lane.
    """
    frames = len(kinds[0].where) if kinds else 0
    if not frames or any(kind.where.shape != (frames, len(names)) for kind in kinds):
        raise InputError(f"repairs to draw must be (frames, {len(names)}) arrays with frames")
    lanes = _lanes(names, kinds, least_frames)
    height = HEAD_HEIGHT + (len(lanes) * _ROW_HEIGHT + 44 if lanes else 0)
    page = new_picture(_PAGE_WIDTH, height, PAGE)
    y = draw_header(page, title, facts, margin=REPAIR_MARGIN)
    draw_verdict(page, verdict, x=REPAIR_MARGIN, y=y - 4, scale=VERDICT_SCALE)
    inner = _PAGE_WIDTH - 2 * REPAIR_MARGIN
    if not lanes:
        return page
    _draw_key(page, kinds, y=y + _VERDICT_HEIGHT)
    left, width = REPAIR_MARGIN + MARKER_LABEL_WIDTH, inner - MARKER_LABEL_WIDTH
    edges = np.unique(np.minimum(np.arange(width) * frames // width, frames - 1))
    columns = np.searchsorted(edges, np.arange(width) * frames // width, side="right") - 1
    room = MARKER_LABEL_WIDTH - 8
    for row, (label, markers) in enumerate(lanes):
        top = HEAD_HEIGHT + row * _ROW_HEIGHT
        draw_text(page, label, x=REPAIR_MARGIN, y=top, style=_LABEL_STYLE, max_width=room)
        fill_box(page, left, top + 1, width, _ROW_HEIGHT - 3, LANE)
        lane = page[top + 1 : top + _ROW_HEIGHT - 2, left : left + width]
        for kind in kinds:
            where = kind.where[:, markers].any(axis=1)
            lane[:, np.logical_or.reduceat(where, edges)[columns]] = kind.color
    bottom = HEAD_HEIGHT + len(lanes) * _ROW_HEIGHT + 4
    draw_frame_axis(page, left, bottom, width, first_frame=first_frame, count=frames)
    return page


def _lanes(
    names: Sequence[str], kinds: Sequence[RepairKind], least_frames: int
) -> list[tuple[str, list[int]]]:
    """Return the label and the markers of each lane."""
    counts = np.sum([kind.where.sum(axis=0) for kind in kinds], axis=0)
    order = [int(marker) for marker in np.argsort(-counts, kind="stable") if counts[marker]]
    in_own_lane = [
        marker
        for marker in order
        if any(longest_run(kind.where[:, marker]) >= least_frames for kind in kinds)
    ][:MOST_LANES]
    rest = [marker for marker in order if marker not in in_own_lane]
    lanes = [(f"{names[marker]}  {int(counts[marker])}", [marker]) for marker in in_own_lane]
    if rest:
        lanes.append((f"{len(rest)} others  {int(counts[rest].sum())}", rest))
    return lanes


def _draw_key(page: ByteImage, kinds: Sequence[RepairKind], *, y: int) -> None:
    x = REPAIR_MARGIN
    for kind in kinds:
        fill_box(page, x, y + 4, 12, 12, kind.color)
        label = f"{kind.label}: {pluralize(int(kind.where.sum()), 'sample')}"
        draw_text(page, label, x=x + 18, y=y, style=_NOTE_STYLE)
        x += 18 + text_width(label, _NOTE_STYLE) + 28
