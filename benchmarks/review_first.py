"""Verdicts and ranked moments without keys, compared with the true errors.

References of `crosstake` are from its first half. Its second half is a typical take; `onesided` has
winks and half smiles of the same performer that are in no reference, and was not used for any
choice. The recorded takes of one performer have untuned proposals: the take of the references, and
a take of the brows with references of the cheeks.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from benchmarks import crosstake
from benchmarks._damage import DAMAGES
from tests.conftest import SHARED_DATA
from usdface.model.review.moments import MOMENT_SECONDS, ReviewSignals, review_moments
from usdface.model.review.verdict import SolveVerdict, judge_solve
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import SelectSpec
from usdface.steps.review.scoring import ShotMetric, read_keys, set_up_shot_baseline
from usdface.steps.review.shot import Shot, open_shot

REFERENCES = 50
MOMENTS = 12
RECORDED = ("Cheeks", "Eyebrows")


@dataclass(frozen=True)
class Ranked:
    """Quality of the ranking of a take's moments without keys."""

    spearman: float
    found: int
    """Number of the worst moments within `MOMENT_SECONDS` of a listed one."""
    keyed_found: int
    """The same for the ranking with keys."""


def run() -> None:
    """Print the verdict on every take, and the scores of the rankings."""
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    verdicts: dict[str, SolveVerdict] = {}
    ranked: dict[str, Ranked] = {}
    with tempfile.TemporaryDirectory() as name:
        for take, performance, keys, frames in _keyed_takes(Path(name)):
            shot = open_shot(performance, frames=frames)
            ruler = ShotMetric(shot)
            truth = read_keys(keys, shot, None, [])
            signals = ruler.signals(None, set_up_shot_baseline(shot))
            keyed = ruler.signals(truth)
            ranked[take] = rank(shot, signals, keyed)
            verdicts[take] = judge_solve(signals.evidence)
            verdicts[f"{take}, with keys"] = judge_solve(keyed.evidence)
        for take, performance in _recorded_takes(Path(name)):
            shot = open_shot(performance)
            verdicts[take] = judge_solve(ShotMetric(shot).evidence(None))
    _print(verdicts, ranked)


def rank(shot: Shot, signals: ReviewSignals, keyed: ReviewSignals) -> Ranked:
    """Compare the ranking without keys with the error against keys."""
    rate = float(shot.take.rate)
    near = MOMENT_SECONDS * rate
    error = keyed.score_mm
    worst: list[int] = []
    free = np.ones(len(error), bool)  # independent of `review_moments`
    for row in np.argsort(-error, kind="stable").tolist():
        if free[row] and len(worst) < MOMENTS:
            worst.append(row)
            free[max(row - round(near) + 1, 0) : row + round(near)] = False
    counts = []
    for each in (signals, keyed):
        listed = np.array([moment.row for moment in review_moments(each, MOMENTS, rate=rate)])
        counts.append(sum(int(np.abs(listed - row).min()) <= near for row in worst))
    return Ranked(float(spearmanr(signals.score_mm, error)[0]), counts[0], counts[1])


def _keyed_takes(folder: Path) -> list[tuple[str, Path, Path, str | None]]:
    rig = SHARED_DATA / "rigs" / "facecap_head.usdc"
    usual, other = folder / "usual", folder / "other"
    last = len(np.load(SHARED_DATA / "crosstake" / "truth.npz")["weights"])
    for place, name in ((usual, "crosstake"), (other, "onesided")):
        place.mkdir()
        crosstake.prepare(place, DAMAGES[0], np.load(SHARED_DATA / name / "truth.npz"), name)
    crosstake.map_take(crosstake.choose_references(usual, rig, REFERENCES), rig, "auto")
    _map(other / "x.clean.take.usda", usual / "x.mapping.usdc", rig, other / "x.hero.usda")
    return [
        (
            "crosstake, second half",
            usual / "x.hero.usda",
            usual / "keys.csv",
            f"{crosstake.HALF + 1}-{last}",
        ),
        ("onesided", other / "x.hero.usda", other / "keys.csv", None),
    ]


def _recorded_takes(folder: Path) -> list[tuple[str, Path]]:
    rig = SHARED_DATA / "rigs" / "ict_face.usdc"
    for name in RECORDED:
        source = SHARED_DATA / "markers_animface" / f"{name}MoCap.c3d"
        execute(IngestSpec(sources=(source,), out=folder / f"{name}.take.usda"))
        execute(
            CleanSpec(take=folder / f"{name}.take.usda", out=folder / f"{name}.clean.take.usda")
        )
    references, mapping = folder / "c.references.usda", folder / "c.mapping.usdc"
    first = folder / f"{RECORDED[0]}.clean.take.usda"
    execute(SelectSpec(takes=(first,), rig=rig, out=references, count=30))
    execute(TrainSpec(references=references, out=mapping))
    found = []
    for name in RECORDED:
        out = folder / f"{name}.usda"
        _map(folder / f"{name}.clean.take.usda", mapping, rig, out)
        found.append((f"{name.lower()} by proposals of {RECORDED[0].lower()}", out))
    return found


def _map(take: Path, mapping: Path, rig: Path, out: Path) -> None:
    execute(MapSpec(take=take, mapping=mapping, rig=rig, out=out))


def _print(verdicts: dict[str, SolveVerdict], ranked: dict[str, Ranked]) -> None:
    print("| take | verdict | to do |")
    print("|---|---|---|")
    for take, verdict in verdicts.items():
        print(f"| {take} | {verdict.sentence} | {verdict.advice} |")
    print("\n| measure | value | wanted |")
    print("|---|---|---|")
    for take, each in ranked.items():
        print(f"| rank correlation with the error, no keys, {take} | {each.spearman:.2f} | ≥ 0.5 |")
        found = f"{each.found} of {MOMENTS}"
        print(f"| worst moments found without keys, {take} | {found} | ≥ 8 |")
        keyed = f"{each.keyed_found} of {MOMENTS}"
        print(f"| worst moments found with keys, {take} | {keyed} | {MOMENTS} |")
