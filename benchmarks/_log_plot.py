"""A plot with two logarithmic axes, as SVG: sharp at any size, and text where it is read."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

WIDTH, HEIGHT = 860, 520
LEFT, RIGHT, TOP, BOTTOM = 80, 270, 56, 64
LABEL_PIXELS = 19
COLORS = ("#0072b2", "#d55e00", "#009e73", "#9b4f96", "#b8860b", "#4d4d4d", "#c2185b", "#2e8bc0")
"""Told apart by most who see colours otherwise; labels name every line all the same."""


@dataclass(frozen=True)
class Line:
    """Measured dots, and two ends of the law through them."""

    label: str
    color: str
    sizes: Sequence[float]
    seconds: Sequence[float]
    fitted: tuple[float, float]


@dataclass(frozen=True)
class _Axes:
    low_x: float
    high_x: float
    low_y: float
    high_y: float

    def x(self, value: float) -> float:
        share = (math.log10(value) - self.low_x) / (self.high_x - self.low_x)
        return LEFT + share * (WIDTH - LEFT - RIGHT)

    def y(self, value: float) -> float:
        share = (math.log10(value) - self.low_y) / (self.high_y - self.low_y)
        return HEIGHT - BOTTOM - share * (HEIGHT - BOTTOM - TOP)


def log_plot(title: str, across: str, lines: Sequence[Line]) -> str:
    """Return an SVG picture of processor seconds over size."""
    axes = _axes(lines)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="14">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        _text(LEFT, 30, title, size=17, weight="bold"),
        *_grid(axes),
        _text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 16, across, anchor="middle"),
        f'<text transform="translate(22 {(TOP + HEIGHT - BOTTOM) / 2:.0f}) rotate(-90)" '
        'text-anchor="middle" fill="#222222">seconds of the processor</text>',
        *_slope_one(axes),
    ]
    places = _apart([axes.y(line.fitted[1]) for line in lines])
    for line, place in zip(lines, places, strict=True):
        parts += _curve(axes, line, place)
    return "\n".join([*parts, "</svg>", ""])


def _axes(lines: Sequence[Line]) -> _Axes:
    """Span all that is drawn: across with a little air, upwards whole decades where they fit."""
    sizes = [size for line in lines for size in line.sizes]
    times = [time for line in lines for time in (*line.seconds, *line.fitted)]
    low = float(math.floor(math.log10(min(times))))
    if math.log10(min(times)) - low < 0.15:
        low -= 0.3  # no dot on the frame
    return _Axes(
        math.log10(min(sizes)) - 0.06,
        math.log10(max(sizes)) + 0.06,
        low,
        math.ceil(math.log10(max(times))),
    )


def _grid(axes: _Axes) -> list[str]:
    parts = []
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    decades = range(math.floor(axes.low_x), math.ceil(axes.high_x) + 1)
    # Where a decade is wide, more than its ends has to be told.
    wide = axes.high_x - axes.low_x < 2.2
    for value in (digit * 10.0**decade for decade in decades for digit in (1, 2, 5)):
        if axes.low_x <= math.log10(value) <= axes.high_x:
            x, told = axes.x(value), wide or math.log10(value) % 1 == 0
            parts.append(_rule(x, TOP, x, bottom, "#dddddd" if told else "#f0f0f0"))
            if told:
                parts.append(_text(x, bottom + 20, f"{value:,.0f}", anchor="middle"))
    for decade in range(math.floor(axes.low_y), int(axes.high_y) + 1):
        for value in (digit * 10.0**decade for digit in (1, 2, 5)):
            told = value == 10.0**decade or axes.high_y - axes.low_y < 2
            if told and axes.low_y <= math.log10(value) <= axes.high_y:
                y = axes.y(value)
                parts.append(_rule(LEFT, y, right, y, "#dddddd"))
                parts.append(_text(LEFT - 8, y + 5, f"{value:g}", anchor="end"))
    parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{right - LEFT}" height="{bottom - TOP}" fill="none" '
        'stroke="#888888"/>'
    )
    return parts


def _slope_one(axes: _Axes) -> list[str]:
    """Draw what linear looks like, from the lower left."""
    rise = min(axes.high_x - axes.low_x, axes.high_y - axes.low_y)
    start_x, start_y = 10.0**axes.low_x, 10.0**axes.low_y
    end_x, end_y = axes.x(start_x * 10**rise), axes.y(start_y * 10**rise)
    early = start_x * 10 ** (0.15 * rise), start_y * 10 ** (0.15 * rise)
    return [
        f'<line x1="{axes.x(start_x):.1f}" y1="{axes.y(start_y):.1f}" x2="{end_x:.1f}" '
        f'y2="{end_y:.1f}" stroke="#999999" stroke-dasharray="3 5"/>',
        # Below it there is rarely anything: few calls beat the smallest at the smallest size.
        _text(axes.x(early[0]) + 10, axes.y(early[1]) + 13, "linear", color="#777777"),
    ]


def _curve(axes: _Axes, line: Line, place: float) -> list[str]:
    color = line.color
    first, last = axes.x(line.sizes[0]), axes.x(line.sizes[-1])
    start, end = (axes.y(each) for each in line.fitted)
    right = WIDTH - RIGHT
    return [
        f'<line x1="{first:.1f}" y1="{start:.1f}" x2="{last:.1f}" y2="{end:.1f}" '
        f'stroke="{color}" stroke-width="2"/>',
        *(
            f'<circle cx="{axes.x(size):.1f}" cy="{axes.y(time):.1f}" r="4" fill="{color}"/>'
            for size, time in zip(line.sizes, line.seconds, strict=True)
        ),
        f'<polyline points="{last + 6:.1f},{end:.1f} {right + 4},{place:.1f} {right + 12},'
        f'{place:.1f}" fill="none" stroke="{color}" stroke-opacity="0.45"/>',
        _text(right + 16, place + 5, line.label, color=color),
    ]


def _apart(heights: Sequence[float]) -> list[float]:
    """Move labels as little as it takes to keep them one line apart, and within the picture."""
    order = sorted(range(len(heights)), key=lambda index: heights[index])
    places = list(heights)
    for before, index in zip([None, *order], order, strict=False):
        least = TOP + 6 if before is None else places[before] + LABEL_PIXELS
        places[index] = max(places[index], least)
    for after, index in zip([None, *order[::-1]], order[::-1], strict=False):
        most = HEIGHT - BOTTOM - 6 if after is None else places[after] - LABEL_PIXELS
        places[index] = min(places[index], most)
    return places


def _rule(x1: float, y1: float, x2: float, y2: float, color: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{color}"/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    color: str = "#222222",
    anchor: str = "start",
    size: int = 14,
    weight: str = "normal",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" text-anchor="{anchor}" font-size="{size}" '
        f'font-weight="{weight}">{escape(text)}</text>'
    )
