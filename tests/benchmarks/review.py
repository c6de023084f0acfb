"""Pictures: composing a sheet, drawing a face, a movie's pictures, the report's script."""

import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.conftest import SHARED_DATA
from usdface.assets import Rig
from usdface.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.media.camera import frame_rig
from usdface.media.movie import write_movie
from usdface.media.movie_frame import MoviePanel, compose_movie_frame
from usdface.media.render import FaceRenderer
from usdface.media.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.usdio.rig import read_rig

REPEATS = 3


def run() -> None:
    """Print CPU seconds of one core: the least of a few runs."""
    rig, name = _rig()
    deformer = Deformer(rig)
    renderer = FaceRenderer(rig.meshes)
    camera = frame_rig(rig.meshes, yaw_degrees=12)
    weights = np.random.default_rng(0).uniform(0, 0.6, (1, len(rig.shapes)))
    posed = deformer.points(weights)[0]

    def draw(size: int, quality: str) -> Callable[[], object]:
        return lambda: renderer.render(
            posed, camera=camera, width=size, height=size, quality=quality
        )

    print(f"On {name}: {renderer.point_count:,} points.\n")
    print("| measure | CPU seconds | wanted |")
    print("|---|---|---|")
    print(f"| a face of 512², shadow and occlusion | {_cpu(draw(512, 'final')):.2f} | ≤ 2.5 |")
    print(f"| a face of 320², draft | {_cpu(draw(320, 'draft')):.2f} | ≤ 0.25 |")
    print(f"| a sheet of 100 tiles of 320², drawn already | {_cpu(_sheet()):.2f} | ≤ 0.5 |")
    pictures = 24
    seconds = _cpu(lambda: _movie(renderer, deformer, camera, len(rig.shapes), pictures))
    print(f"| a movie's picture of 640 × 360, draft | {seconds / pictures:.2f} | ≤ 0.5 |")


def _rig() -> tuple[Rig, str]:
    file = SHARED_DATA / "rigs" / "ict_head.usdc"
    if file.is_file():
        return read_rig(file), "ict_head"
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
    renderer: FaceRenderer, deformer: Deformer, camera: object, shapes: int, count: int
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
