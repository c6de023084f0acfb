"""Speed of pictures: contact sheets, faces, movie frames, the report's script."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from benchmarks._long_report import SECONDS, make_and_play
from tests.conftest import SHARED_DATA
from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.media.face.camera import Camera, frame_rig
from usdface.media.face.render import FaceRenderer, Quality
from usdface.media.film.movie import write_movie
from usdface.media.film.movie_frame import MoviePanel, compose_movie_frame
from usdface.media.picture.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.usdio.rig.read import read_rig

REPEATS = 3
SCALED = 4
HEAVY = "ict_head"


def run() -> None:
    """Print processor seconds of one core: the shortest of a few runs."""
    rig, name = _rig()
    deformer = Deformer(rig)
    renderer = FaceRenderer(rig.meshes)
    camera = frame_rig(rig.meshes, yaw_degrees=12)
    poses = cycle(_poses(rig))

    def draw(size: int, quality: Quality) -> Callable[[], object]:
        return lambda: renderer.render(
            next(poses), camera=camera, width=size, height=size, quality=quality
        )

    print(f"On {name}: {len(deformer.neutral):,} points.\n")
    print("| measure | CPU seconds | wanted |")
    print("|---|---|---|")
    print(f"| a face of 512², shadow and occlusion | {_cpu(draw(512, 'final')):.2f} | ≤ 2.5 |")
    print(f"| a face of 320², draft | {_cpu(draw(320, 'draft')):.2f} | ≤ 0.25 |")
    print(f"| a sheet of 100 tiles of 320², drawn already | {_cpu(_sheet()):.2f} | ≤ 0.5 |")
    pictures = 24
    seconds = _cpu(lambda: _movie(renderer, deformer, camera, len(rig.shapes), pictures))
    print(f"| a movie's picture of 640 × 360, draft | {seconds / pictures:.2f} | ≤ 0.5 |")
    _print_scaling()
    _print_report(rig, name)


def _print_scaling() -> None:
    """Print the slowdown of two processes that draw at the same time."""
    context = get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        list(pool.map(_draw_some, [1, 1]))  # both processes have read the rig
        alone = pool.submit(_draw_some, SCALED).result()
        both = [future.result() for future in [pool.submit(_draw_some, SCALED) for _ in range(2)]]
    mean = sum(each.cpu for each in both) / 2
    print("\nDrawing by two processes at once, 512², final:\n")
    print("| measure | one alone | two at once | wanted |")
    print("|---|---|---|---|")
    print(f"| CPU seconds a face | {alone.cpu / SCALED:.2f} | {mean / SCALED:.2f} | as one alone |")
    fastest = 2 * SCALED / max(each.wall for each in both)
    one = SCALED / alone.wall
    print(f"| faces a second | {one:.2f} | {fastest:.2f} | twice, on a quiet machine |")


@dataclass(frozen=True)
class _Spent:
    cpu: float
    wall: float


def _draw_some(count: int) -> _Spent:
    """Draw faces in a separate process."""
    renderer, camera, poses = _scene()
    cpu, wall = time.process_time(), time.perf_counter()
    for posed in poses[:count]:
        renderer.render(posed, camera=camera, width=512, height=512, quality="final")
    return _Spent(time.process_time() - cpu, time.perf_counter() - wall)


@cache
def _scene() -> tuple[FaceRenderer, Camera, FloatArray]:
    rig, _ = _rig()
    return FaceRenderer(rig.meshes), frame_rig(rig.meshes, yaw_degrees=12), _poses(rig)


def _poses(rig: Rig) -> FloatArray:
    """Return the points of different expressions, as a renderer remembers the last one drawn."""
    weights = np.random.default_rng(0).uniform(0, 0.6, (SCALED, len(rig.shapes)))
    return Deformer(rig).points(weights)


def _print_report(rig: Rig, name: str) -> None:
    """Print the size of a minute's report, and the cost of a picture in a browser."""
    if name != HEAVY:
        print(f"\nNo report of a minute: {HEAVY} is not there.")
        return
    try:
        with TemporaryDirectory() as folder:
            made = make_and_play(Path(folder), rig)
    except pytest.skip.Exception as absent:
        print(f"\nNo report of a minute: {absent}")
        return
    print(f"\nThe report of {SECONDS} s on {name}, {made.pictures:,} pictures, in Chromium:\n")
    print("| measure | measured | wanted |")
    print("|---|---|---|")
    print(f"| the page | {made.megabytes:.1f} MB | < 30 MB |")
    print(f"| script a picture, processor time | {made.script_ms:.1f} ms | ≤ 6 ms |")
    print(f"| the same by the clock, fastest tenth | {made.wall_ms[0]:.1f} ms | |")
    print(f"| the same by the clock, median | {made.wall_ms[1]:.1f} ms | |")


def _rig() -> tuple[Rig, str]:
    file = SHARED_DATA / "rigs" / "ict_head.usdc"
    if file.is_file():
        return read_rig(file), HEAVY
    return demo_rig(), "the demo's character"


def _cpu(work: Callable[[], object]) -> float:
    found = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def _sheet() -> Callable[[], object]:
    rng = np.random.default_rng(0)
    tiles = [rng.integers(0, 255, (320, 320, 3), np.uint8) for _ in range(100)]
    rows = tuple(
        SheetRow(
            frame=row,
            timecode="01:00:00:00",
            tiles=tuple(Tile(tiles[4 * row + column], value=0.5) for column in range(4)),
        )
        for row in range(25)
    )
    page = SheetPage(title="a hundred tiles", columns=("a", "b", "c", "d"), rows=rows)
    return lambda: compose_sheet(page)


def _movie(
    renderer: FaceRenderer, deformer: Deformer, camera: Camera, shapes: int, count: int
) -> None:
    weights = 0.5 + 0.5 * np.sin(np.arange(count)[:, None] / 9 + np.arange(shapes)[None])
    video = np.full((360, 278, 3), 80, np.uint8)

    def pictures():  # type: ignore[no-untyped-def]
        for row in weights:
            face = renderer.render(
                deformer.points(row[None])[0],
                camera=camera,
                width=360,
                height=360,
                quality="draft",
            )
            panels = [MoviePanel(278, video, "video"), MoviePanel(360, face, "usdface")]
            yield compose_movie_frame(panels, height=360, title="a shot", clock="01:00:00:00 1")

    with TemporaryDirectory() as folder:
        write_movie(Path(folder) / "review.mp4", pictures(), rate=Fraction(24))
