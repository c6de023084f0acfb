"""Performers whose face is that of another head than the rig's, from the C3D file to weights.

The performer moves by the shapes of one head, and the rig is another: their shapes of one name
differ in place, direction and size, and in how they add up. Captures are drawn as those of
`random_captures`, without damage. One-sided: channels of the right side seven seconds late, of
those that both heads have for both sides. Errors are against the weights of the same names.
"""

import tempfile
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.random_captures import (
    Performer,
    Setup,
    draw_setup,
    performances,
    rig_shapes,
    run_command,
    score,
    write_keys,
)
from tests.conftest import SHARED_DATA
from usdface.usdio.rig.read import read_rig

SETUPS, QUICK_SETUPS = 4, 1
OTHER_HEAD = {"ict_face": "facecap_head", "facecap_head": "ict_face"}
METHODS = ("auto", "ridge", "kernel_cca", "baseline")
TAKES = ("references'", "another", "one-sided")
RATE, LATE_SECONDS = 60, 7


def run(*, quick: bool = False) -> None:
    """Print errors of every method; `quick` runs the first set-up."""
    if not (SHARED_DATA / "rigs").is_dir():
        print(f"skipped: no rigs in {SHARED_DATA}")
        return
    print("vertex RMS [mm] of the take of the references, of another and of one-sided motion\n")
    print(f"| set-up | {' | '.join(METHODS)} | face | worst region |")
    print(f"|---|{'---|' * (len(METHODS) + 2)}")
    errors, shares = [], []
    for number in range(QUICK_SETUPS if quick else SETUPS):
        setup, found, within = measure(number)
        cells = [", ".join(f"{error:.2f}" for error in each) for each in found]
        face, worst = min(each[0] for each in within), min(min(each[1:]) for each in within)
        print(
            f"| {number}: {setup.rig}, {setup}, key error {setup.key_error} | {' | '.join(cells)} "
            f"| {100 * face:.0f} % | {100 * worst:.0f} % |",
            flush=True,
        )
        errors.append(found)
        shares.append((face, worst))
    means = np.exp(np.log(errors).mean(axis=0))
    print(f"\n| geometric mean | {' | '.join(TAKES)} |\n|---|---|---|---|")
    for method, mean in zip(METHODS, means, strict=True):
        print(f"| {method} | {' | '.join(f'{each:.2f}' for each in mean)} |")
    larger = (np.array(errors)[:, :1] > np.array(errors)[:, 1:]).any(axis=1).sum(axis=0)
    print("\n| measure | value |\n|---|---|")
    for take, count in zip(TAKES, larger, strict=True):
        print(f"| {take}: auto is worse than some other method | {count} of {len(errors)} |")
    below = (np.array(shares)[:, 1] < 0.8).sum()
    print(f"| set-ups in which some take has a region below 80 % | {below} of {len(errors)} |")


def measure(number: int) -> tuple[Setup, list[list[float]], list[list[float]]]:
    """Return a set-up, the errors of each method and take, and the default's shares by take."""
    rng = np.random.default_rng(91_000 + number)
    setup = _undamaged(draw_setup(rng), rng)
    own, other = (
        SHARED_DATA / "rigs" / f"{name}.usdc" for name in (setup.rig, OTHER_HEAD[setup.rig])
    )
    shapes, performer_shapes = rig_shapes(own), rig_shapes(other)
    acted, moved = ([*performances(file, setup)] for file in (own, other))
    late = [set(shapes.names), set(performer_shapes.names)]
    late_names = {
        name
        for name in set.intersection(*late)
        if name.endswith("right") and all(name[:-5] + "left" in each for each in late)
    }
    acted.append(_one_sided(acted[1], shapes.names, late_names))
    moved.append(_one_sided(moved[1], performer_shapes.names, late_names))
    performer = Performer(performer_shapes, setup, rng)
    with tempfile.TemporaryDirectory() as name, chdir(name):
        for take, weights in zip("abc", moved, strict=True):
            performer.capture(Path(f"{take}.c3d"), weights, 0.0, rng)
        error = 1 + setup.key_error * rng.standard_normal(acted[0].shape)
        write_keys(Path("keys.csv"), read_rig(own).shapes, np.clip(acted[0] * error, 0, 1))
        for take in "abc":
            _run(f"ingest {take}.c3d --out {take}.take.usda --neutral 3 --performer p --session a")
            _run(f"clean {take}.take.usda --out {take}.clean.take.usda")
        _run(f"select a.clean.take.usda --rig {own} --count {setup.pairs} --out r.usda")
        _run("references import r.usda --weights keys.csv")
        errors: list[list[float]] = []
        shares: list[list[float]] = []
        for method in METHODS:
            option = "--baseline"
            if method != "baseline":
                option = f"--mapping {method}.usdc"
                _run(f"train r.usda --method {method} --out {method}.usdc")
            errors.append([])
            for take, weights in zip("abc", acted, strict=True):
                out = f"{take}.{method}.usda"
                _run(f"map {take}.clean.take.usda --rig {own} {option} --out {out}")
                rms, within = score(Path(out), weights, shapes)
                errors[-1].append(rms)
                if method == METHODS[0]:
                    shares.append(within)
    return setup, errors, shares


def _undamaged(setup: Setup, rng: np.random.Generator) -> Setup:
    band = str(rng.choice(["three", "band"]))
    return replace(
        setup,
        band=band,
        reapplied_mm=0.0,
        noise_mm=min(setup.noise_mm, 0.2),
        rate=RATE,
        metres=False,
        swaps=0,
        gaps=0,
        lost=0,
        outliers=0,
    )


def _one_sided(weights: np.ndarray, names: tuple[str, ...], late: set[str]) -> np.ndarray:
    """Return a performance with some channels late, from rest."""
    moved = weights.copy()
    for column, name in enumerate(names):
        if name in late:
            moved[:, column] = np.roll(weights[:, column], RATE * LATE_SECONDS)
    moved[:RATE] *= np.clip(np.arange(RATE) / RATE * 2 - 1, 0, 1)[:, None]
    return moved


def _run(line: str) -> None:
    code, said = run_command(line)
    if code:
        raise SystemExit(f"{line}: {said}")
