"""Axes and curves on a picture: just enough to show evidence."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.picture.canvas import Color, draw_dot, draw_line, fill_box, outline_box
from usdface.media.picture.text import TextStyle, draw_text, text_width

PANEL: Color = (31, 33, 37)
FRAME: Color = (64, 67, 74)
GRID: Color = (44, 47, 53)
_LABEL = TextStyle(size=14, color=(152, 157, 166))
_CAPTION = TextStyle(size=15, color=(222, 224, 228), weight="bold")
_TICK_PIXELS = 90


@dataclass(frozen=True)
class Plot:
    """A panel with axes: where it lies on the picture and what it spans.

    Attributes
    ----------
    picture : (height, width, 3) uint8 array
        Drawn into.
    x, y, width, height : int
        The panel [pixels].
    left, right, bottom, top : float
        Values at its edges.
    """

    picture: ByteImage
    x: int
    y: int
    width: int
    height: int
    left: float
    right: float
    bottom: float
    top: float

    def column(self, value: float) -> float:
        """Return where a value lies across [pixels]."""
        return self.x + (value - self.left) / (self.right - self.left) * self.width

    def row(self, value: float) -> float:
        """Return where a value lies from above, limited to the panel [pixels]."""
        share = (value - self.bottom) / (self.top - self.bottom)
        return self.y + (1 - min(max(share, 0.0), 1.0)) * self.height

    def draw_axes(self, caption: str, *, across: str, up: str, whole: bool = False) -> None:
        """Draw the panel, its grid and its labels.

        Parameters
        ----------
        caption : str
            What is shown.
        across, up : str
            What the axes mean, with unit.
        whole : bool
            Whether across only whole numbers mean something: frames.
        """
        fill_box(self.picture, self.x, self.y, self.width, self.height, PANEL)
        places = ticks(self.left, self.right, self.width // _TICK_PIXELS)
        if whole:
            places = [value for value in places if abs(value - round(value)) < 1e-6]
        for value in places:
            column = round(self.column(value))
            fill_box(self.picture, column, self.y, 1, self.height, GRID)
            label = f"{value:.0f}" if whole else tick_label(value, self.right - self.left)
            below = self.y + self.height + 4
            draw_text(self.picture, label, x=column, y=below, style=_LABEL, anchor="middle")
        for value in ticks(self.bottom, self.top, self.height // 50):
            row = round(self.row(value))
            fill_box(self.picture, self.x, row, self.width, 1, GRID)
            label = tick_label(value, self.top - self.bottom)
            draw_text(self.picture, label, x=self.x - 8, y=row - 10, style=_LABEL, anchor="right")
        outline_box(self.picture, self.x, self.y, self.width, self.height, FRAME)
        above = self.y - 25
        draw_text(self.picture, caption, x=self.x, y=above, style=_CAPTION)
        beside = self.x + text_width(caption, _CAPTION) + 16
        draw_text(self.picture, up, x=beside, y=above + 1, style=_LABEL)
        end = self.x + self.width
        draw_text(
            self.picture, across, x=end, y=self.y + self.height + 22, style=_LABEL, anchor="right"
        )

    def draw_curve(self, values: FloatArray, heights: FloatArray, color: Color) -> None:
        """Draw a curve; where several samples share a column, from the lowest to the highest.

        Parameters
        ----------
        values : (n,) float array
            Ascending.
        heights : (n,) float array
            NaN where there is nothing to show.
        color : tuple of int
        """
        shown = np.isfinite(heights) & (values >= self.left) & (values <= self.right)
        values, heights = values[shown], heights[shown]
        if not len(values):
            return
        if len(values) < self.width // 2:
            points = [
                (self.column(value), self.row(height))
                for value, height in zip(values.tolist(), heights.tolist(), strict=True)
            ]
            if len(points) == 1:
                draw_dot(self.picture, *points[0], 4.0, color)
            for start, end in pairwise(points):
                draw_line(self.picture, start, end, color)
            return
        columns = np.clip(
            ((values - self.left) / (self.right - self.left) * self.width).astype(int),
            0,
            self.width - 1,
        )
        edges = np.flatnonzero(np.diff(columns, prepend=-1))
        lowest, highest = np.minimum.reduceat(heights, edges), np.maximum.reduceat(heights, edges)
        # A steep curve steps from column to column: let each reach its neighbour.
        beside = np.flatnonzero(np.diff(columns[edges]) == 1)
        before = heights[edges[beside + 1] - 1]
        lowest[beside + 1] = np.minimum(lowest[beside + 1], before)
        highest[beside + 1] = np.maximum(highest[beside + 1], before)
        for column, low, high in zip(
            columns[edges].tolist(), lowest.tolist(), highest.tolist(), strict=True
        ):
            highest_row = round(self.row(high))
            size = max(round(self.row(low)) - highest_row, 2)
            fill_box(self.picture, self.x + column, highest_row, 1, size, color)

    def draw_level(self, height: float, color: Color, label: str) -> None:
        """Draw a limit across the panel, its name at the right."""
        if self.bottom < height < self.top:
            row = round(self.row(height))
            fill_box(self.picture, self.x + 1, row, self.width - 2, 1, color)
            style = TextStyle(size=13, color=color)
            x = self.x + self.width - 6
            draw_text(self.picture, label, x=x, y=row - 18, style=style, anchor="right")

    def draw_mark(self, value: float, color: Color, label: str, *, line: int = 0) -> None:
        """Draw a value down the panel, its name beside it; `line` keeps names apart."""
        if not self.left <= value <= self.right:
            return
        column = round(self.column(value))
        fill_box(self.picture, column - 1, self.y + 1, 2, self.height - 2, color, cover=0.7)
        style = TextStyle(size=14, color=color)
        fits = column + 6 + text_width(label, style) < self.x + self.width
        draw_text(
            self.picture,
            label,
            x=column + 6 if fits else column - 6,
            y=self.y + 4 + 19 * line,
            style=style,
            anchor="left" if fits else "right",
        )

    def draw_points(
        self, values: FloatArray, heights: FloatArray, color: Color, *, hollow: bool = False
    ) -> None:
        """Draw dots; those outside the panel lie on its edge."""
        for value, height in zip(values.tolist(), heights.tolist(), strict=True):
            dot = self.column(value), self.row(height)
            draw_dot(self.picture, *dot, 4.0, color, hollow=hollow)


def ticks(low: float, high: float, count: int) -> list[float]:
    """Return round values within a range, about `count` of them."""
    if not high > low or count < 1:
        return []
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(each * power for each in (1, 2, 5, 10) if each * power >= rough * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def tick_label(value: float, span: float) -> str:
    """Return a tick's number with the decimals that its neighbours need."""
    decimals = min(max(math.ceil(-math.log10(max(span, 1e-12) / 10)), 0), 6)
    return f"{value + 0.0:.{decimals}f}"
