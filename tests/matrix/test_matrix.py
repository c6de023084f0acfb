"""Every command in one chain, from capture to publish, on every kind of take and rig.

Each variant runs alone: `poe slow tests/matrix -k 23.976`.
"""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.matrix import rigs
from tests.matrix.chain import METHODS, Case, run_chain
from tests.matrix.studio import SAME, Weights, assert_same
from tests.steps.small_shot import coarse_rig
from usdface.demo.acting import ActedPerformance, performance

pytestmark = pytest.mark.slow

ROUNDED = 1e-4
"""Largest difference of weights where points are rounded otherwise, to float32 in metres, by which
most differ by 3e-6."""
NAMELESS = 0.06
"""Largest difference of weights of shapes that markers observe, where names say nothing. `select`
then knows no regions and visemes, and takes other frames; lids differ most, by 0.041."""


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Weights:
    return run_chain(tmp_path_factory.mktemp("plain"), Case())[1]


def turned() -> ActedPerformance:
    """Turn the head by 90 degrees and back, every second and a half."""
    acted = performance()
    seconds = np.arange(len(acted.rotation)) / float(acted.weights.rate)
    turn = 45 * (1 - np.cos(2 * np.pi * np.maximum(seconds - 0.4, 0) / 1.5))
    return replace(acted, rotation=acted.rotation + turn[:, None] * [0, 1, 0])


TAKES = {
    "23.976": lambda: Case(rate=Fraction(24000, 1001), timecode="01:00:00:00", methods=METHODS),
    "29.97": lambda: Case(rate=Fraction(30000, 1001), timecode="01:00:00;00"),
    "250": lambda: Case(rate=Fraction(250), timecode="01:00:00:00"),
    "dropouts": lambda: Case(lost_share=0.05),
    "few frames": lambda: Case(start=1.4, seconds=0.2),
    "turned head": lambda: Case(acted=turned()),
}
RIGS = {
    "combinations": lambda: Case(rig=rigs.with_combinations(), methods=METHODS),
    "in-betweens": lambda: Case(rig=rigs.with_inbetweens()),
    "ranges": lambda: Case(rig=rigs.with_signed_ranges()),
    "five shapes": lambda: Case(rig=rigs.with_five_shapes()),
    "dead shapes": lambda: Case(rig=rigs.with_dead_shapes()),
}
ALIKE = {
    "names": (lambda: Case(take="Ä b.c (2) $x"), SAME),
    "timecode": (lambda: Case(timecode="23:59:59:00"), SAME),
    "from 1001": (lambda: Case(first=1001), SAME),
    "Größe 1/täk es.v1 #2": (Case, SAME),
    "text": (lambda: Case(rig_file="hero.usda"), SAME),
    "stage": (lambda: Case(rig_file="hero.usda"), ROUNDED),
    "two faces": (lambda: Case(rig_file="hero.usda", prim="/Shot/b/hero"), ROUNDED),
    "unicode": (lambda: Case(rig=rigs.renamed("Größe_{name}"), keyed=coarse_rig().shapes), SAME),
    "numbered": (
        lambda: Case(rig=rigs.renamed("shape_{k:02d}"), keyed=coarse_rig().shapes),
        NAMELESS,
    ),
}
WRITTEN = {"text": rigs.write_text, "stage": rigs.write_stage, "two faces": rigs.write_two_faces}


@pytest.mark.parametrize("take", TAKES)
def test_a_take_of_another_kind_is_solved(take: str, tmp_path: Path) -> None:
    run_chain(tmp_path, TAKES[take]())


@pytest.mark.parametrize("alike", ALIKE)
def test_names_and_files_do_not_matter(alike: str, tmp_path: Path, plain: Weights) -> None:
    make, limit = ALIKE[alike]
    folder = tmp_path / alike
    folder.mkdir(parents=True)
    if alike in WRITTEN:
        WRITTEN[alike](folder)
    solve = run_chain(folder, make())[1]
    # Without names, eyes follow the lids: no marker shows gaze.
    assert_same(solve, plain, limit, but="eyeLook" if limit == NAMELESS else "-")


@pytest.mark.parametrize("made", RIGS)
def test_a_rig_of_another_kind_is_driven_within_its_ranges(made: str, tmp_path: Path) -> None:
    case = RIGS[made]()
    studio, solve = run_chain(tmp_path, case)
    for weights in (solve, studio.weights("baseline.usda")):
        for shape, (low, high) in zip(case.rig.shapes, case.rig.ranges, strict=True):
            assert np.abs(weights[shape] - np.clip(weights[shape], low, high)).max() <= 1e-6
    if made == "dead shapes":
        assert not solve["nothing"].any()
    for name in ("face_map.usda", "baseline.usda", "baked.usdc", "p.usdz"):
        if made == "combinations":
            rigs.assert_driven(studio.weights(name))
