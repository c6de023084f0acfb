"""Report of a minute on a dense head, made by the command and played in a browser."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser import chromium
from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.assets import Markers, Rig, Take, Video
from usdface.core.deformer import Deformer
from usdface.core.provenance import Provenance
from usdface.media.face.camera import frame_rig, motion_weights
from usdface.media.face.render import FaceRenderer
from usdface.media.film.movie import write_movie
from usdface.runner.execute import execute
from usdface.specs.review import ReportSpec
from usdface.usdio.performance.weights_layer import SolveFigures, make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.take.write import write_take

SECONDS = 60
RATE = Fraction(120)
VIDEO_RATE = Fraction(30)
MARKERS = 70
DRAWN = 60
"""Number of different video pictures, played forwards and backwards in a loop."""

WARM_UP, PLAYED = 40, 200


@dataclass(frozen=True)
class LongReport:
    """Size of the page and cost of a picture.

    Attributes
    ----------
    megabytes : float
    pictures : int
    script_ms : float
        Processor time per picture reported by the browser: weights, curves, posing and draw
        calls.
    wall_ms : tuple of float
        Elapsed time per picture: 10th percentile and median.
    """

    megabytes: float
    pictures: int
    script_ms: float
    wall_ms: tuple[float, float]


def make_and_play(folder: Path, rig: Rig) -> LongReport:
    """Write a performance of a minute, make its report, and step through it."""
    weights = _acted(len(rig.shapes))
    page = _write(folder, rig, weights)
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": 1280, "height": 900})
        tab.goto(page.as_uri())
        tab.wait_for_selector("body[data-ready=true]", timeout=120_000)
        tab.evaluate(PLAY, WARM_UP)
        counters = tab.context.new_cdp_session(tab)
        # Thread time instead of elapsed time, to exclude other programs.
        counters.send("Performance.enable", {"timeDomain": "threadTicks"})
        before = _script_seconds(counters)
        wall = tab.evaluate(PLAY, PLAYED)
        spent = _script_seconds(counters) - before
        pictures = tab.evaluate("JSON.parse(document.getElementById('data').textContent).frames")
    low, median = np.percentile(wall, [10, 50])
    return LongReport(
        megabytes=page.stat().st_size / 1e6,
        pictures=len(pictures),
        script_ms=1000 * spent / PLAYED,
        wall_ms=(float(low), float(median)),
    )


def _script_seconds(counters: Any) -> float:
    metrics = counters.send("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "ScriptDuration"))


PLAY = """async (wanted) => {
  const spent = [];
  for (let i = 0; i < wanted; i++) {
    report.show(7 * i + 1, { fromVideo: true });
    await new Promise((next) => requestAnimationFrame(() => setTimeout(next)));
    spent.push(report.scriptMillis + report.viewer.renderMillis);
  }
  return spent;
}"""


def _acted(shapes: int) -> FloatArray:
    """Return weights of all shapes, each with its own frequency and never constantly 0."""
    seconds = np.arange(int(SECONDS * RATE)) / float(RATE)
    rng = np.random.default_rng(0)
    pace, phase = rng.uniform(0.2, 1.5, shapes), rng.uniform(0, 6, shapes)
    return np.asarray(0.25 + 0.2 * np.sin(2 * np.pi * pace * seconds[:, None] + phase))


def _write(folder: Path, rig: Rig, weights: FloatArray) -> Path:
    deformer = Deformer(rig)
    glued = _spread(deformer.neutral, motion_weights(rig.meshes))
    names = tuple(f"m{number}" for number in range(len(glued)))
    rows = (3 * glued[:, None] + np.arange(3)).ravel()
    keys = deformer.shapes.key_offsets[:, rows]
    moved = deformer.shapes.key_weights(weights) @ keys
    positions = deformer.neutral[glued] + np.asarray(moved).reshape(len(weights), -1, 3)
    seen = np.ones(positions.shape[:2], bool)
    write_movie(folder / "camera.mp4", _pictures(rig, deformer, weights), rate=VIDEO_RATE)
    take = Take(
        name="minute",
        rate=RATE,
        first_frame=1,
        markers=Markers(
            names,
            positions.astype(np.float32),
            seen,
            seen.astype(np.float32),
            rigid=names[-6:],
            neutral_frame=1,
            space="stabilized",
        ),
        video=Video(folder / "camera.mp4", VIDEO_RATE),
        timecode_start="01:00:00:00",
    )
    write_take(folder / "minute.take.usda", take, provenance=Provenance())
    with writing_performance(
        folder / "minute.usda",
        make_header(
            rig,
            shape_names=rig.shapes,
            rate=RATE,
            first_frame=1,
            last_frame=len(weights),
            regions=("face",),
            timecode_start="01:00:00:00",
        ),
        rig,
    ) as writer:
        writer.append(weights, SolveFigures(np.full((len(weights), 1), 0.2)))
    spec = ReportSpec(
        performance=folder / "minute.usda",
        take=folder / "minute.take.usda",
        out=folder / "minute.html",
    )
    execute(spec)
    return folder / "minute.html"


def _spread(points: FloatArray, moves: FloatArray) -> np.ndarray:
    """Return distant points: most on moving skin, six on rigid skin."""
    chosen: list[int] = []
    for pool, count in ((moves > 0.3, MARKERS - 6), (moves < 0.01, 6)):
        rows = np.flatnonzero(pool)
        nearest = np.full(len(rows), np.inf)
        for _ in range(count):
            at = int(np.argmax(nearest)) if np.isfinite(nearest).all() else 0
            chosen.append(int(rows[at]))
            away = np.linalg.norm(points[rows] - points[rows[at]], axis=1)
            nearest = np.minimum(nearest, away)
    return np.array(chosen)


def _pictures(rig: Rig, deformer: Deformer, weights: FloatArray) -> Iterator[ByteImage]:
    renderer, camera = FaceRenderer(rig.meshes), frame_rig(rig.meshes, yaw_degrees=15)
    step = int(RATE / VIDEO_RATE)
    drawn = [
        renderer.render(
            deformer.points(weights[step * k : step * k + 1])[0],
            camera=camera,
            width=480,
            height=360,
            quality="draft",
        )
        for k in range(DRAWN)
    ]
    there_and_back = [*range(DRAWN), *range(DRAWN - 2, 0, -1)]
    for picture in range(int(SECONDS * VIDEO_RATE)):
        yield drawn[there_and_back[picture % len(there_and_back)]]
