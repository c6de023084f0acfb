"""What cleaning repaired, marker by marker over a take: where, how much and what kind."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage
from usdface.core.errors import InputError
from usdface.core.text import pluralize
from usdface.media.picture.canvas import fill_box, new_picture
from usdface.media.picture.color import DIM, LANE, PAGE, SOFT, Color
from usdface.media.picture.error_strip import draw_frame_axis
from usdface.media.picture.sheet import draw_header
from usdface.media.picture.text import TextStyle, draw_text, text_width

_PAGE_WIDTH = 1600
REPAIR_MARGIN = 28
MARKER_LABEL_WIDTH = 190
_ROW_HEIGHT = 17
HEAD_HEIGHT = 156
"""Title, facts and the key of colours."""
MOST_ROWS = 120
"""The markers with most repairs; the rest are counted."""

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
    facts: Sequence[str],
    first_frame: int,
) -> ByteImage:
    """Draw a lane for each marker that was repaired, most repairs first.

    A column is coloured if any of its frames was repaired, so that single samples show.

    Parameters
    ----------
    names : sequence of str
        One per marker.
    kinds : sequence of RepairKind
        Later ones are drawn over earlier ones.
    title, facts
        Written above.
    first_frame : int
        Frame number of the first row of each kind.

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB.
    """
    frames = len(kinds[0].where) if kinds else 0
    if not frames or any(kind.where.shape != (frames, len(names)) for kind in kinds):
        raise InputError(f"repairs to draw must be (frames, {len(names)}) arrays with frames")
    counts = np.sum([kind.where.sum(axis=0) for kind in kinds], axis=0)
    order = [int(i) for i in np.argsort(-counts, kind="stable") if counts[i]][:MOST_ROWS]
    head = HEAD_HEIGHT
    height = head + max(len(order), 1) * _ROW_HEIGHT + 64
    page = new_picture(_PAGE_WIDTH, height, PAGE)
    inner = _PAGE_WIDTH - 2 * REPAIR_MARGIN
    y = draw_header(page, title, facts, margin=REPAIR_MARGIN)
    _draw_key(page, kinds, y=y)
    left, width = REPAIR_MARGIN + MARKER_LABEL_WIDTH, inner - MARKER_LABEL_WIDTH
    if not order:
        draw_text(page, "nothing was repaired", x=REPAIR_MARGIN, y=head, style=_NOTE_STYLE)
    edges = np.unique(np.minimum(np.arange(width) * frames // width, frames - 1))
    columns = np.searchsorted(edges, np.arange(width) * frames // width, side="right") - 1
    for row, marker in enumerate(order):
        top = head + row * _ROW_HEIGHT
        label = f"{names[marker]}  {int(counts[marker])}"
        draw_text(
            page,
            label,
            x=REPAIR_MARGIN,
            y=top,
            style=_LABEL_STYLE,
            max_width=MARKER_LABEL_WIDTH - 8,
        )
        fill_box(page, left, top + 1, width, _ROW_HEIGHT - 3, LANE)
        lane = page[top + 1 : top + _ROW_HEIGHT - 2, left : left + width]
        for kind in kinds:
            touched = np.logical_or.reduceat(kind.where[:, marker], edges)[columns]
            lane[:, touched] = kind.color
    bottom = head + max(len(order), 1) * _ROW_HEIGHT + 4
    draw_frame_axis(page, left, bottom, width, first_frame=first_frame, count=frames)
    hidden = int((counts > 0).sum()) - len(order)
    if hidden:
        draw_text(
            page,
            f"and {pluralize(hidden, 'marker')} with fewer",
            x=REPAIR_MARGIN,
            y=bottom + 22,
            style=_NOTE_STYLE,
        )
    return page


def _draw_key(page: ByteImage, kinds: Sequence[RepairKind], *, y: int) -> None:
    x = REPAIR_MARGIN
    for kind in kinds:
        fill_box(page, x, y + 4, 12, 12, kind.color)
        label = f"{kind.label}: {pluralize(int(kind.where.sum()), 'sample')}"
        draw_text(page, label, x=x + 18, y=y, style=_NOTE_STYLE)
        x += 18 + text_width(label, _NOTE_STYLE) + 28
