"""What a contact sheet puts side by side: video, markers, faces, differences."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.media.picture.sheet import Tile
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.specs.review import SheetSpec
from usdface.steps.review.frame_choice import ChosenFrame
from usdface.steps.review.pictures import Shot, ShotPictures
from usdface.steps.review.scoring import Score


@dataclass(frozen=True)
class Column:
    """Something drawn for every row."""

    head: str
    draw: Callable[[int], Tile]


def sheet_columns(
    spec: SheetSpec,
    shots: list[Shot],
    pictures: list[ShotPictures],
    judged: list[Score],
    equation: BlendshapeEquation,
    truth: FloatArray | None,
    chosen: list[ChosenFrame],
    high: float,
) -> list[Column]:
    """Return what the layout puts side by side."""
    shot, drawn = shots[0], pictures[0]
    columns: list[Column] = []
    if shot.take.video is not None:
        columns.append(Column("video", lambda row: drawn.video(int(shot.frames[row]))))
    if spec.layout != "strip":
        explained = dict(
            zip(
                [frame.row for frame in chosen],
                equation.explained(shot.weights[[frame.row for frame in chosen]]),
                strict=True,
            )
        )
        columns.append(
            Column("markers", lambda row: Tile(drawn.markers(row, explained=explained[row])))
        )
    names = {"equation": "equation solving", "usdface": "this performance"}
    others = iter(pictures[1:])
    for each in judged:
        own = drawn if each.label in names else next(others)
        columns.append(Column(names.get(each.label, each.label), _face(own, each)))
    compared = _compared(judged, truth)
    if spec.difference and compared is not None and spec.layout in ("comparison", "worst"):
        columns.append(
            Column(
                f"away from {compared[0]}", _away(drawn, shot.weights, compared[1], high_mm=high)
            )
        )
    return columns


def _face(pictures: ShotPictures, judged: Score) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        error = float(judged.error_mm[row])
        value = None if np.isnan(error) else error
        return Tile(pictures.face(row, judged.weights[row]), value=value)

    return draw


def _away(
    pictures: ShotPictures, weights: FloatArray, other: FloatArray, *, high_mm: float
) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        if np.isnan(other[row]).any():
            return Tile(None, caption="nothing keyed here")
        painted = pictures.difference(row, weights[row], other[row], high_mm=high_mm)
        return Tile(painted.picture, caption=f"at most {painted.largest_mm:.1f} mm")

    return draw


def _compared(judged: list[Score], truth: FloatArray | None) -> tuple[str, FloatArray] | None:
    if truth is not None:
        return "truth", truth
    return next((("equation", j.weights) for j in judged if j.label == "equation"), None)
