"""Cleaning of a take with known damage: swaps, unseen rigid markers, unchanged samples, cost.

`--full` also ingests and cleans an hour of the demo's actor, by the installed commands.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile
from scipy.spatial.transform import Rotation

from benchmarks._long_take import write_captures
from benchmarks._process import measure_usdface
from benchmarks._takes import markers_of
from benchmarks.scale import HOUR
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.assets import Markers
from usdface.numerics.repair.cleaning import CleanedMarkers, clean_markers

STRIDE = 10
"""The fixture keeps the undamaged markers of every tenth frame."""

NOD_DEGREES, NOD_HZ = 8.0, 0.5
"""Nods of up to 25 degrees per second, in which the rigid markers are unseen."""
GAPS = (3, 10, 30, 90)
"""[frames] One in every `GAP_EVERY`."""
GAP_EVERY = 450

EXCHANGED = ("F023", "F090")
LONG_SWAPS = (0.1, 0.2, 0.3, 0.4)
"""Neighbours whose distance varies most, and shares of a take with their labels exchanged."""
LONG_SWAP_FRAMES = 1000


def run(*, full: bool = False) -> None:
    """Print relabelled swaps, cost, and the growth of the time with the take."""
    source = SHARED_DATA / "crosstake"
    if not source.is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    said = json.loads((source / "take.json").read_text())
    take = read_capture(source / "take.c3d").take
    markers = markers_of(take)
    rigid = [markers.names.index(name) for name in said["rigid"]]
    truth = np.load(source / "truth.npz")
    _damaged(markers, rigid, said["neutral_frame"], truth)
    _unseen_skull(markers, rigid, said["neutral_frame"], float(take.rate), truth["clean"])
    _long_swaps(markers, rigid, said["neutral_frame"])
    if full:
        _hour()


def _damaged(markers: Markers, rigid: list[int], neutral: int, truth: NpzFile) -> None:
    def clean(times: int = 1) -> tuple[CleanedMarkers, float]:
        positions = np.tile(markers.positions, (times, 1, 1))
        visible = np.tile(markers.visible, (times, 1))
        start = time.process_time()
        cleaned = clean_markers(positions, visible, rigid=rigid, neutral=neutral)
        return cleaned, time.process_time() - start

    cleaned, seconds = clean()
    swapped = np.zeros(markers.visible.shape, np.bool_)
    for first, second, start, stop in truth["swaps"]:
        swapped[start:stop, [first, second]] = True
    relabelled = sum(_is_relabelled(cleaned, each) for each in truth["swaps"])
    touched = cleaned.filled.copy()
    for swap in cleaned.swaps:
        touched[swap.start : swap.stop, [swap.first, swap.second]] = True
    good = markers.visible & ~swapped
    error = _errors(cleaned, truth["clean"].astype(np.float64))
    repaired = (swapped | ~markers.visible)[::STRIDE][: len(error)]
    _, twice = clean(2)
    print("| measure | value | wanted |")
    print("|---|---|---|")
    print(f"| swapped intervals relabelled | {relabelled} of {len(truth['swaps'])} | ≥ 95 % |")
    print(f"| good samples touched | {100 * touched[good].mean():.3f} % | < 0.1 % |")
    print(f"| mean error, relabelled and filled | {error[repaired].mean():.3f} mm | < 0.3 mm |")
    print(f"| mean error of the others | {error[~repaired].mean():.3f} mm | |")
    print(f"| processor time, {len(markers.visible):,} frames | {seconds:.1f} s | |")
    print(f"| for twice the frames | {twice / seconds:.2f}× | linear |")


def _unseen_skull(
    markers: Markers, rigid: list[int], neutral: int, rate: float, truth: np.ndarray
) -> None:
    """Print the error of frames whose rigid markers are all unseen while the head nods."""
    frames = len(markers.visible)
    angle = NOD_DEGREES * np.sin(2 * np.pi * NOD_HZ * np.arange(frames) / rate)
    nods = Rotation.from_rotvec(np.outer(np.deg2rad(angle - angle[neutral]), [1, 0, 0])).as_matrix()
    centre = np.nanmean(markers.positions[neutral], axis=0)
    nodding = (markers.positions - centre) @ nods.transpose(0, 2, 1) + centre
    print("\n| rigid markers unseen | mean error [mm] | largest |\n|---|---|---|")
    for length in (0, *GAPS):
        visible, gaps = markers.visible.copy(), np.zeros(frames, np.bool_)
        for middle in range(GAP_EVERY, frames - GAP_EVERY, GAP_EVERY):
            gaps[middle - max(length, 1) // 2 : middle + -(-max(length, 1) // 2)] = True
        if length:
            visible[np.ix_(np.flatnonzero(gaps), np.array(rigid))] = False
        cleaned = clean_markers(nodding, visible, rigid=rigid, neutral=neutral)
        found = _errors(cleaned, truth.astype(np.float64))[gaps[::STRIDE][: len(truth)]]
        print(f"| {length} frames | {found.mean():.2f} | {found.mean(axis=1).max():.2f} |")


def _long_swaps(markers: Markers, rigid: list[int], neutral: int) -> None:
    """Print the frames that keep exchanged labels of two markers, of a thousand frames."""
    rows = slice(neutral, neutral + LONG_SWAP_FRAMES)
    pair = [markers.names.index(name) for name in EXCHANGED]
    print(f"\n| {' and '.join(EXCHANGED)} exchanged | frames wrong after `clean` |\n|---|---|")
    for share in LONG_SWAPS:
        count = round(share * LONG_SWAP_FRAMES)
        swap = np.array([*sorted(pair), 300, 300 + count])
        positions, visible = markers.positions[rows].copy(), markers.visible[rows].copy()
        for each in (positions, visible):
            each[swap[2] : swap[3], pair] = each[swap[2] : swap[3], pair[::-1]]
        cleaned = clean_markers(positions, visible, rigid=rigid, neutral=0)
        wrong = np.zeros(LONG_SWAP_FRAMES, np.bool_)
        wrong[swap[2] : swap[3]] = True
        for found in cleaned.swaps:
            if {found.first, found.second} == set(pair):
                wrong[found.start : found.stop] ^= True
        print(f"| {share:.0%} of the frames | {wrong.sum()} |")


def _hour() -> None:
    """Print the cost of an hour, without extrapolation."""
    print(f"\n| {HOUR:,} frames, 102 markers | processor s | peak memory, MB |")
    print("|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_captures(folder, (HOUR,))
        for step, words in (
            ("ingest", f"ingest {HOUR}.c3d --out hour.take.usda --neutral 31"),
            ("clean", "clean hour.take.usda --out hour.clean.take.usda"),
        ):
            cost = measure_usdface(folder, words)
            print(f"| `{step}` | {cost.seconds:.0f} | {cost.peak_mb:,.0f} |")


def _is_relabelled(cleaned: CleanedMarkers, swap: np.ndarray) -> bool:
    """Whether detected swaps cover 90 % of a true one, and little else."""
    first, second, start, stop = (int(value) for value in swap)
    covered = np.zeros(stop - start, np.bool_)
    for found in cleaned.swaps:
        if {found.first, found.second} == {first, second}:
            covered[max(found.start - start, 0) : max(found.stop - start, 0)] = True
    return bool(covered.mean() >= 0.9)


def _errors(cleaned: CleanedMarkers, truth: np.ndarray) -> np.ndarray:
    """Return the distance of every sample from the truth, after rigid alignment [mm]."""
    found = cleaned.positions[::STRIDE][: len(truth)].astype(np.float64)
    a, b = found.reshape(-1, 3), truth.reshape(-1, 3)
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    moved = (found - a.mean(axis=0)) @ (u @ vt) + b.mean(axis=0)
    return np.linalg.norm(moved - truth, axis=2)
