"""Smoothing over time: one mapping of crosstake in every mode."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from tests.conftest import SHARED_DATA
from usdface.runner.execute import execute
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.usdio.performance.read import read_performance

COUNT = 50
MODES: dict[str, dict[str, object]] = {
    "none": {"temporal": "none"},
    "whole take": {"temporal": "whole"},
    "causal, 2 frames late": {"temporal": "causal"},
    "whole take, 12 Hz": {"temporal": "whole", "cutoff": 12.0},
    "whole take, 8 Hz": {"temporal": "whole", "cutoff": 8.0},
    "1 octave removed": {"temporal": "bands", "bands": 1},
    "2 octaves removed": {"temporal": "bands", "bands": 2},
    "3 octaves removed": {"temporal": "bands", "bands": 3},
}
TAKES = {"as recorded": tuple(MODES), "noise 0.5 mm": ("none", "whole take")}


def run() -> None:
    """Print vertex RMS [mm], blink bias and jitter of every mode, on the second half."""
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    ruler, truth = crosstake.read_ruler(), np.load(SHARED_DATA / "crosstake" / "truth.npz")
    rig = SHARED_DATA / "rigs" / "facecap_head.usdc"
    print("| take | mode | vertex RMS | blink bias | jitter |")
    print("|---|---|---|---|---|")
    for kind, modes in TAKES.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            crosstake.prepare(folder, kind, truth)
            mapping, out = folder / "x.mapping.usdc", folder / "x.hero.usda"
            references = crosstake.choose_references(folder, rig, COUNT)
            execute(TrainSpec(references=references, out=mapping))
            for mode in modes:
                spec = {"take": folder / "x.clean.take.usda", "mapping": mapping, "rig": rig}
                execute(MapSpec(**spec, out=out, **MODES[mode]), overwrite=True)
                clip = read_performance(out).weights
                solved = (clip.names, clip.values.astype(float))
                figures = crosstake.score(ruler, solved, truth, rig)
                print(
                    f"| {kind} | {mode} | {figures['vertex_rms_mm']:.3f} | "
                    f"{figures['blink_bias']:+.3f} | {figures['jitter']:.2f} |",
                    flush=True,
                )
