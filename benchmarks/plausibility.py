"""Plausibility checks: false alarms on recorded faces, and detection of simulated faults.

The recorded takes of `markers_animface` with all markers, with random subsets, and on faces of
other proportions. An alarm is a property that `ingest` refuses or doubts. In the first two rows
alarms are false, except for `part`: some subsets have no marker on one side or half of the face.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.conftest import SHARED_DATA
from usdface.capture.axes import rotation_to_y_up
from usdface.capture.sniff import read_capture
from usdface.core.assets import Markers
from usdface.model.placement.label_hints import mirrored_label
from usdface.model.placement.plausibility import judge_markers

TAKES = ("CheeksMoCap", "EyebrowsMoCap")
COUNTS = (8, 12, 20, 41)
FRAMES = 300
PROPORTIONS = (0.75, 1.15)
"""Range of the factors of width, height and depth: from a child of five to a large adult."""

Damage = Callable[[Markers, np.random.Generator], Markers]


def run(draws: int = 20) -> None:
    """Print the share of draws with each alarm."""
    folder = SHARED_DATA / "markers_animface"
    if not folder.is_dir():
        print(f"skipped: no markers_animface in {SHARED_DATA}")
        return
    takes = [read_capture(folder / f"{name}.c3d").take for name in TAKES]
    print(f"share of {2 * draws} draws with an alarm (refused / doubted)\n")
    print(f"| the take | {' | '.join(f'{count} markers' for count in COUNTS)} |")
    print(f"|---|{'---|' * len(COUNTS)}")
    for words, damage in DAMAGES.items():
        cells = []
        for count in COUNTS:
            rng = np.random.default_rng(count)
            found: Counter[tuple[str, bool]] = Counter()
            for take in takes:
                if take.markers is None:
                    continue
                for _ in range(draws):
                    drawn = damage(_draw(take.markers, count, rng), rng)
                    found.update((f.aspect, f.impossible) for f in judge_markers(drawn, 60.0))
            cells.append(_cell(found, 2 * draws))
        print(f"| {words} | {' | '.join(cells)} |")


def _cell(found: Counter[tuple[str, bool]], draws: int) -> str:
    aspects = dict.fromkeys(aspect for aspect, _ in found)
    shares = [
        f"{aspect} {found[aspect, True] / draws:.0%} / {found[aspect, False] / draws:.0%}"
        for aspect in aspects
    ]
    return ", ".join(shares) or "none"


def _draw(markers: Markers, count: int, rng: np.random.Generator) -> Markers:
    """Return a random subset of the markers, on both sides and halves of the face."""
    keep = np.sort(rng.choice(len(markers.names), count, replace=False))
    return Markers(
        tuple(markers.names[i] for i in keep),
        markers.positions[:FRAMES, keep],
        markers.visible[:FRAMES, keep],
        markers.confidence[:FRAMES, keep],
    )


def _times(matrix: np.ndarray) -> Damage:
    return lambda markers, rng: replace(
        markers, positions=markers.positions @ matrix.T.astype(np.float32)
    )


def _proportioned(markers: Markers, rng: np.random.Generator) -> Markers:
    return _times(np.diag(rng.uniform(*PROPORTIONS, 3)))(markers, rng)


def _relabelled(markers: Markers, rng: np.random.Generator) -> Markers:
    names = tuple((mirrored_label(name) or (name,))[0] for name in markers.names)
    return replace(markers, names=names)


DAMAGES: dict[str, Damage] = {
    "as recorded": lambda markers, rng: markers,
    "other proportions": _proportioned,
    "1:10": _times(0.1 * np.eye(3)),
    "× 25.4": _times(25.4 * np.eye(3)),
    "Y read as Z": _times(rotation_to_y_up(up="z", where="")),
    "labels mirrored": _relabelled,
    "axes mirrored": _times(np.diag([-1.0, 1.0, 1.0])),
}
