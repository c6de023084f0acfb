"""Capture of an hour, 102 markers at 120 Hz, relative to lower bounds of the same run."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

FRAMES = 432_000
MARKERS = 102
RIGID = 12
LOOPED = 3_000
"""Frames of the loops, whose time per frame is extrapolated."""


def run() -> None:
    """Print each measure as a ratio to its lower bound."""
    print("| measure | ours | floor | ratio |")
    print("|---|---|---|---|")
    _stabilisation()
    if Path("/proc/self/status").exists():
        _ingest()


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _stabilisation() -> None:
    from usdface.numerics.rigid.rigid_alignment import align_rigid, remove_motion

    rng = np.random.default_rng(0)
    shape = rng.uniform(-70, 70, (MARKERS, 3))
    turns = Rotation.from_rotvec(0.5 * np.sin(np.arange(FRAMES)[:, None] / [170, 390, 110]))
    cloud = np.empty((FRAMES, MARKERS, 3), np.float32)
    for start in range(0, FRAMES, 20_000):
        part = slice(start, start + 20_000)
        matrices = turns[part].as_matrix()
        cloud[part] = np.einsum("fij,mj->fmi", matrices, shape)
        cloud[part] += rng.normal(0, 0.15, cloud[part].shape)
    rigid = np.ascontiguousarray(cloud[:, :RIGID])
    begin = cloud[:LOOPED].copy()
    found: dict[str, np.ndarray] = {}
    looped: list[np.ndarray] = []

    def ours() -> None:
        alignment = align_rigid(rigid, shape[:RIGID])
        remove_motion(cloud, alignment, out=cloud)
        found["rotations"] = alignment.rotations

    def loop() -> None:
        reference = shape[:RIGID] - shape[:RIGID].mean(axis=0)
        for frame in range(LOOPED):
            points = rigid[frame].astype(np.float64)
            centred = points - points.mean(axis=0)
            rotation, _ = Rotation.align_vectors(centred, reference)
            looped.append(rotation.as_matrix())
            begin[frame] = (begin[frame] - points.mean(axis=0)) @ rotation.as_matrix()

    mine, theirs = _seconds(ours), _seconds(loop) * FRAMES / LOOPED
    away = np.abs(found["rotations"][:LOOPED] - np.array(looped)).max()
    print(
        f"| stabilisation, {FRAMES:,} × {MARKERS} | {mine:.1f} s | align_vectors, looped "
        f"{theirs:.0f} s | {theirs / mine:.0f}× faster, equal to {away:.0e} |"
    )


_INGEST = """
import sys
from pathlib import Path
from usdface.specs.capture import IngestSpec
from usdface.runner.execute import execute
import usdface.steps.capture.ingest

def peak():  # ru_maxrss includes the parent process
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1])

before = peak()
execute(IngestSpec(sources=(Path(sys.argv[1]),), out=Path(sys.argv[2])))
print((peak() - before) / 1024)
"""

_FLOOR = """
import sys
import numpy as np
from pxr import Sdf, Vt
raw = open(sys.argv[1], "rb").read()
frames, markers = int(sys.argv[3]), int(sys.argv[4])
cloud = np.frombuffer(raw, "<f4", frames * markers * 4, len(raw) - frames * markers * 16)
cloud = np.ascontiguousarray(cloud.reshape(frames, markers, 4)[..., :3])
layer = Sdf.Layer.CreateNew(sys.argv[2])
prim = Sdf.CreatePrimInLayer(layer, "/p")
prim.specifier, prim.typeName = Sdf.SpecifierDef, "Points"
Sdf.AttributeSpec(prim, "points", Sdf.ValueTypeNames.Point3fArray)
for frame in range(frames):
    layer.SetTimeSample("/p.points", frame, Vt.Vec3fArray.FromNumpy(cloud[frame]))
layer.Save()
"""


def _ingest() -> None:
    """Compare ingest with reading the bytes and writing the bare points."""
    from tests.c3d_write import write_c3d

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rng = np.random.default_rng(0)
        motion = rng.normal(0, 80, (1, MARKERS, 3)) + rng.normal(0, 5, (FRAMES, 1, 3))
        noise = rng.standard_normal((FRAMES, MARKERS, 3), dtype=np.float32)
        labels = [f"m{i}" for i in range(MARKERS)]
        visible = np.ones((FRAMES, MARKERS), np.bool_)
        write_c3d(folder / "long.c3d", motion + noise, visible, labels, rate=120)
        del motion, noise, visible
        peak = 0.0

        def ours() -> None:
            nonlocal peak
            done = _python(_INGEST, folder / "long.c3d", folder / "long.take.usda")
            peak = float(done.stdout)

        def floor() -> None:
            _python(_FLOOR, folder / "long.c3d", folder / "floor.usdc", FRAMES, MARKERS)

        bare, mine = _seconds(floor), _seconds(ours)
        raw = FRAMES * MARKERS * 3 * 4 / 2**20
        print(
            f"| ingest, {FRAMES:,} frames | {mine:.1f} s | read bytes, write .usdc {bare:.1f} s | "
            f"{mine / bare:.1f}× |"
        )
        print(f"| its memory | {peak:.0f} MB | raw float array {raw:.0f} MB | {peak / raw:.2f}× |")


def _python(script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        env=os.environ,
        capture_output=True,
        text=True,
        check=True,
    )
