"""Comparison of the files written by two versions.

::

    python -m benchmarks.same_results make before     # with one version installed
    python -m benchmarks.same_results make after      # with the other version
    python -m benchmarks.same_results compare before after

`make` runs the demo and, if the fixtures exist, `crosstake`: from the capture to a report, every
regression, another character, a mesh without shapes. `compare` prints the largest difference of the
numbers of every USD file, and the files that are in one folder only.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Sdf

from tests.conftest import SHARED_DATA

HALF = 4030
METHODS = ("auto", "face_map", "ridge", "rbf", "d06", "multiquadric", "kernel_cca", "hybrid")
RETARGETINGS = ("auto", "rbf", "kernel_cca", "hybrid", "additive", "ridge")
TOLERANCE = 1e-6
LAYERS = {".usda", ".usdc"}


def main() -> int:
    """Make outputs, or compare two folders of them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    tasks.add_parser("make").add_argument("folder", type=Path)
    compared = tasks.add_parser("compare")
    compared.add_argument("before", type=Path)
    compared.add_argument("after", type=Path)
    compared.add_argument("--tolerance", type=float, default=TOLERANCE)
    asked = parser.parse_args()
    if asked.task == "make":
        make(asked.folder.resolve())
        return 0
    return compare(asked.before, asked.after, tolerance=asked.tolerance)


def run() -> None:
    """Make the demo twice, in two processes, and compare."""
    with tempfile.TemporaryDirectory() as name:
        for label in ("once", "again"):
            (Path(name) / label).mkdir()
            _make_demo(Path(name) / label)
        compare(Path(name) / "once", Path(name) / "again", tolerance=0.0)


def make(folder: Path) -> None:
    """Run all compared commands with the installed version."""
    folder.mkdir(parents=True)
    _make_demo(folder)
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"the demo alone: no crosstake in {SHARED_DATA}")
        return
    cross = folder / "cross"
    cross.mkdir()
    take = json.loads((SHARED_DATA / "crosstake" / "take.json").read_text())
    for name in ("crosstake/take.c3d", "rigs/facecap_head.usdc", "rigs/ict_head.usdc"):
        shutil.copy(SHARED_DATA / name, cross)
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    with (cross / "keys.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *truth["shapes"]])
        writer.writerows([i, *row] for i, row in enumerate(truth["weights"], start=1))
    rigid, neutral = ",".join(take["rigid"]), str(take["neutral_frame"] + 1)
    for line in _commands(rigid, neutral):
        _usdface(cross, *line.split(), "--json")


def _make_demo(folder: Path) -> None:
    _usdface(folder, "demo", "--out", "demo", "--progress", "none")


def _commands(rigid: str, neutral: str) -> Iterator[str]:
    yield f"ingest take.c3d --out x.take.usda --rigid {rigid} --neutral {neutral}"
    yield "clean x.take.usda --out x.clean.take.usda"
    yield (
        "select x.clean.take.usda --rig facecap_head.usdc --out x.references.usda "
        f"--count 50 --frames 1-{HALF}"
    )
    yield "references import x.references.usda --weights keys.csv"
    yield "references coverage x.references.usda x.clean.take.usda --out coverage.png"
    for method in METHODS:
        yield f"train x.references.usda --out {method}.mapping.usdc --method {method}"
        yield (
            f"map x.clean.take.usda --mapping {method}.mapping.usdc --rig facecap_head.usdc "
            f"--out {method}.hero.usda"
        )
    for temporal in ("whole", "causal", "bands"):
        yield (
            "map x.clean.take.usda --mapping ridge.mapping.usdc --rig facecap_head.usdc "
            f"--out {temporal}.hero.usda --frames 100-800 --temporal {temporal}"
        )
    yield "evaluate auto.hero.usda --against keys.csv --out evaluate.json"
    yield ("sheet auto.hero.usda --take x.clean.take.usda --out sheet.jpg --quality draft --rows 6")
    yield (
        "report auto.hero.usda --take x.clean.take.usda --out report.html --frames 1-600 "
        "--against keys.csv"
    )
    yield ("pairs propose --source facecap_head.usdc --target ict_head.usdc --out p.pairs.usda")
    for method in RETARGETINGS:
        yield f"train-retarget p.pairs.usda --out {method}.retarget.usdc --method {method}"
        yield (
            f"retarget auto.hero.usda --retargeting {method}.retarget.usdc --out {method}.ict.usda"
        )
    yield "bind x.clean.take.usda facecap_head.usdc --out b.binding.usda"
    for label, options in (
        ("hmc", "--sampler hmc"),
        ("shared", "--sampler shared"),
    ):
        yield (
            "deform x.clean.take.usda --mesh facecap_head.usdc --binding b.binding.usda "
            f"--out {label}.points.usda --frames 100-140 {options}"
        )
    # On facecap_head two markers share a point, which radial basis functions refuse.
    yield "bind x.clean.take.usda ict_head.usdc --out i.binding.usda"
    yield (
        "deform x.clean.take.usda --mesh ict_head.usdc --binding i.binding.usda "
        "--out rbf.points.usda --frames 100-140 --method rbf"
    )


def _usdface(folder: Path, *words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "usdface", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    label = " ".join(words[:6])
    if done.returncode:
        print(f"exit {done.returncode}: {label}\n{done.stderr.strip()[-400:]}", flush=True)


def compare(before: Path, after: Path, *, tolerance: float) -> int:
    """Print differences of the numbers in two folders; return 1 if any exceeds the tolerance."""
    names = {
        folder: {p.relative_to(folder) for p in folder.rglob("*") if p.suffix in LAYERS}
        for folder in (before, after)
    }
    beyond = 0
    for name in sorted(names[before] ^ names[after]):
        print(f"{name}: only in {before if name in names[before] else after}")
        beyond += 1
    print("| file | numbers | largest difference | at |\n|---|---|---|---|")
    for name in sorted(names[before] & names[after]):
        count, largest, place = _difference(before / name, after / name)
        if largest > tolerance:
            beyond += 1
            print(f"| {name} | {count} | {largest:.3g} | {place} |")
        else:
            print(f"| {name} | {count} | {largest:.1g} | {place if 'only' in place else ''} |")
    print(f"{beyond} files differ by more than {tolerance:g}")
    return 1 if beyond else 0


def _difference(one: Path, other: Path) -> tuple[int, float, str]:
    first, second = _numbers(one), _numbers(other)
    lone = sorted(first.keys() ^ second.keys())
    largest, place, count = 0.0, f"{len(lone)} only in one, as {lone[0]}" if lone else "", 0
    for key in first.keys() & second.keys():
        value, partner = first[key], second[key]
        count += value.size
        away = (
            float("inf")
            if value.shape != partner.shape
            else float(np.abs(value - partner).max(initial=0.0))
        )
        if not away <= largest:
            largest, place = away, key
    return count, largest, place


def _numbers(file: Path) -> dict[str, np.ndarray]:
    """Return all numbers of a layer, by path and time code."""
    layer = Sdf.Layer.FindOrOpen(str(file))
    found: dict[str, np.ndarray] = {}

    def visit(path: Sdf.Path) -> None:
        spec = layer.GetObjectAtPath(path)
        if not isinstance(spec, Sdf.AttributeSpec):
            return
        _keep(found, str(path), spec.default)
        for time in layer.ListTimeSamplesForPath(path):
            _keep(found, f"{path} at {time:g}", layer.QueryTimeSample(path, time))

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found


def _keep(found: dict[str, np.ndarray], key: str, value: object) -> None:
    try:
        number = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return
    if value is not None:
        found[key] = number


if __name__ == "__main__":
    sys.exit(main())
