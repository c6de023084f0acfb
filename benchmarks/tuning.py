"""Latency of the tuning page: from a slider to the face, and from a change to the disk."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np

from benchmarks.waits import many_shapes
from tests.browser import chromium
from tests.conftest import SHARED_DATA
from tests.tuning.test_page import Command, Page
from usdface.core.assets import References, Rig
from usdface.core.deformer import Deformer
from usdface.core.provenance import Provenance
from usdface.core.sidecars import tuned_path
from usdface.demo.rig import demo_rig
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

PAIRS, MARKERS, SLIDES = 100, 100, 60
LIMIT_MS = 50.0
MANY_SHAPES, RUNS = 250, 3
BROWSER_START_SECONDS = 1.0
"""Time that a person's browser takes from the command's link to its request of the page."""

_SLIDE = """async (count) => {
  const times = [];
  const draws = [];
  for (let k = 0; k < count; k++) {
    const shape = k % tune.state.names.length;
    const slider = document.querySelector(`[data-shape="${shape}"] input[type=range]`);
    const begun = performance.now();
    slider.value = 0.2 + 0.6 * Math.random();
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    tune.viewer.draw();
    times.push(performance.now() - begun);
    draws.push(tune.viewer.renderMillis);
    await new Promise((resolve) => setTimeout(resolve, 25));
  }
  return { times, draws };
}"""


def run() -> None:
    """Print times, with their limit or the time of the bare write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = _rig(folder)
        path = _asset(folder, rig)
        points = sum(len(mesh.points) for mesh in rig.meshes)
        print(f"{rig.file.name}: {points:,} points, {len(rig.shapes)} shapes, {PAIRS} pairs\n")
        print("| measure | median | 95 % | beside |")
        print("|---|---|---|---|")
        _saving(path)
        _posting(path, rig.shapes[0])
        _sliding(path)
        _opening(folder)


def _opening(folder: Path) -> None:
    """Print how long the page of a rig with many shapes takes, from the server's first line."""
    rig, take, asset = (folder / name for name in ("many.rig.usdc", "demo", "many.usda"))
    write_rig(rig, many_shapes(MANY_SHAPES))
    select = f"select {take}/demo.clean.take.usda --rig {rig} --count {PAIRS // 2} --out {asset}"
    for words in (f"demo --out {take}", select):
        subprocess.run(
            [sys.executable, "-m", "usdface", *words.split()], check=True, capture_output=True
        )
    face, markers = [], []
    with chromium() as browser:
        for _ in range(RUNS):
            command = Command(asset)
            try:
                time.sleep(BROWSER_START_SECONDS)
                begun = time.perf_counter()
                page = Page(browser.new_context(), command.link)
                face.append(time.perf_counter() - begun)
                page.wait("!!tune.residual")
                markers.append(time.perf_counter() - begun)
                page.page.close()
            finally:
                command.interrupt()
    print(f"| {MANY_SHAPES} shapes, page opened until the face is shown | {_seconds(face)} |")
    print(f"| {MANY_SHAPES} shapes, page opened until markers are shown | {_seconds(markers)} |")


def _seconds(found: list[float]) -> str:
    return f"{np.median(found):.1f} s | {np.percentile(found, 95):.1f} s | "


def _sliding(path: Path) -> None:
    with chromium() as browser:
        command = Command(path)
        try:
            page = Page(browser.new_context(viewport={"width": 1600, "height": 900}), command.link)
            page.wait("!!tune.residual || document.getElementById('markers').disabled")
            page.page.evaluate(_SLIDE, 8)  # lets the browser compile the script
            found = page.page.evaluate(_SLIDE, SLIDES)
            page.saved()
        finally:
            command.interrupt()
    limit = f"limit {LIMIT_MS:g} ms"
    _row("slider to commands of the new picture, script", found["times"], limit)
    _row("of that: morph, normals, upload, draw calls", found["draws"], "")


def _posting(path: Path, shape: str) -> None:
    """Send changes without a browser, which would draw on the server's processor."""
    command = Command(path)
    home = command.link.split("/?")[0]
    rights = {"origin": home, "x-usdface-tune": "1", "content-type": "application/json"}
    taken: list[float] = []
    try:
        with httpx.Client(base_url=home) as client:
            client.get(command.link)
            revision = client.get("/state.json").json()["revision"]
            for step in range(60):
                change = {"pair": 1, "take": "take", "frame": 1, "weights": {shape: step / 100}}
                begun = time.perf_counter()
                answer = client.post(
                    "/changes", json={"revision": revision, "changes": [change]}, headers=rights
                )
                taken.append(1e3 * (time.perf_counter() - begun))
                revision = answer.json()["revision"]
    finally:
        command.interrupt()
    _row("change to answer over HTTP, on disk by then", taken, "")


def _saving(path: Path) -> None:
    session = TuningSession(path)
    applied, saved, bare = [], [], []
    probe = path.with_name("probe")
    try:
        for step in range(30):
            change = Change(
                step,
                session.references.takes[step],
                int(session.references.frames[step]),
                {session.references.shape_names[0]: 0.01 * step + 0.005},
            )
            begun = time.perf_counter()
            session.apply([change], revision=session.revision)
            applied.append(1e3 * (time.perf_counter() - begun))
            begun = time.perf_counter()
            session.save()
            saved.append(1e3 * (time.perf_counter() - begun))
            begun = time.perf_counter()
            _write_bare(probe, path)
            bare.append(1e3 * (time.perf_counter() - begun))
    finally:
        session.close()
    floor = f"bare write and fsync of the layer's bytes {np.median(bare):.1f} ms"
    _row("change into the journal, fsync", applied, floor)
    _row(f"tuned layer of {PAIRS} pairs written", saved, floor)


def _write_bare(probe: Path, path: Path) -> None:
    data = tuned_path(path).read_bytes()
    with probe.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _row(what: str, milliseconds: list[float], beside: str) -> None:
    middle, high = np.percentile(milliseconds, [50, 95])
    print(f"| {what} | {middle:.1f} ms | {high:.1f} ms | {beside} |")


def _rig(folder: Path) -> Rig:
    """Return the large head if its file exists, else the demo's."""
    large = SHARED_DATA / "rigs" / "ict_head.usdc"
    if large.is_file():
        return read_rig(large)
    path = folder / "demo.usdc"
    write_rig(path, demo_rig())
    return read_rig(path)


def _asset(folder: Path, rig: Rig) -> Path:
    """Write references with markers at points of the rig."""
    rng = np.random.default_rng(0)
    deformer = Deformer(rig)
    weights = rng.random((PAIRS, len(rig.shapes))) * (rng.random((PAIRS, len(rig.shapes))) < 0.2)
    moved = abs(deformer.shapes.target_offsets()).sum(axis=0).reshape(-1, 3).sum(axis=1)
    carriers = rng.choice(np.argsort(-moved)[:4000], MARKERS, replace=False)
    posed = np.array([deformer.points(row[None])[0][carriers] for row in weights])
    references = References(
        marker_names=tuple(f"m{index}" for index in range(MARKERS)),
        shape_names=rig.shapes,
        markers=posed,
        weights=weights,
        frames=np.arange(PAIRS),
        takes=("take",) * PAIRS,
        tuned=np.zeros(PAIRS, dtype=np.bool_),
        rigid=(),
        neutral=deformer.neutral[carriers],
        rig_file=rig.file,
        rig_prim=rig.prim,
    )
    path = folder / "large.references.usda"
    write_references(path, references, rig, provenance=Provenance())
    return path
