"""A shot made once for many tests: the demo's actor, four seconds, and every file up to a sheet."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest
import yaml

from tests.c3d_write import write_c3d
from usdface.core.assets import Rig
from usdface.demo import half_cage
from usdface.demo.acting import performance
from usdface.demo.build import write_weights
from usdface.demo.capture import demo_markers, simulate_capture
from usdface.demo.head import DemoHead, bare_head
from usdface.demo.rig import rig_from_head, with_shapes
from usdface.demo.sculpt import ACTOR, CHARACTER, Style
from usdface.usdio.rig.write import write_rig

FRAMES = 480
PAIRS = 24


@dataclass(frozen=True)
class Shot:
    """Files of a shot that has been run; tests copy what they change."""

    folder: Path
    rigid: tuple[str, ...]
    neutral: int

    def __truediv__(self, name: str) -> Path:
        return self.folder / name


def coarse_head(style: Style) -> DemoHead:
    """Build a head of the demo whose cage is subdivided once: 8,000 of 19,000 points."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(half_cage, "REFINEMENT_LEVELS", 1)
        return with_shapes(bare_head(style))


@cache
def coarse_rig(style: Style = CHARACTER) -> Rig:
    """Build a rig of the demo with fewer points, by default the character of the shot."""
    return rig_from_head(coarse_head(style))


def make_inputs(folder: Path) -> Shot:
    """Write rig, capture, keys and a job; run nothing."""
    rig = coarse_rig()
    write_rig(folder / "hero.usdc", rig)
    actor, acted = coarse_head(ACTOR), performance()
    markers = demo_markers(actor)
    positions, visible = simulate_capture(actor, acted, markers)
    write_c3d(
        folder / "shot.c3d",
        positions[:FRAMES],
        visible[:FRAMES],
        markers.names,
        rate=acted.weights.rate,
        first_frame=1,
    )
    # Keys of more frames than the take has, as those of a whole scene are.
    keys = replace(acted.weights, values=acted.weights.values[: FRAMES + 60])
    write_weights(folder / "keys.csv", keys, rig.shapes)
    steps = [
        {
            "step": "ingest",
            "sources": ["shot.c3d"],
            "out": "shot.take.usda",
            "rigid": list(markers.rigid),
            "neutral": acted.neutral_frame,
            "timecode": "01:00:00:00",
        },
        {"step": "clean", "take": "shot.take.usda", "out": "shot.clean.take.usda"},
        {
            "step": "select",
            "takes": ["shot.clean.take.usda"],
            "rig": "hero.usdc",
            "count": PAIRS,
            "out": "hero.references.usda",
        },
        {
            "step": "references-import",
            "references": "hero.references.usda",
            "weights": "keys.csv",
        },
        {
            "step": "train",
            "references": "hero.references.usda",
            "out": "hero.mapping.usdc",
            "method": "face_map",  # what auto chooses here as well, without comparing
        },
        {
            "step": "map",
            "take": "shot.clean.take.usda",
            "mapping": "hero.mapping.usdc",
            "rig": "hero.usdc",
            "out": "shot.hero.usda",
        },
        {
            "step": "sheet",
            "performance": "shot.hero.usda",
            "take": "shot.clean.take.usda",
            "against": "keys.csv",
            "out": "shot.sheet.jpg",
            "rows": 2,
            "tile": 96,
            "quality": "draft",
        },
    ]
    text = yaml.safe_dump({"job": "shot", "steps": steps}, sort_keys=False)
    (folder / "shot.job.yaml").write_text(text, encoding="utf-8")
    return Shot(folder, markers.rigid, acted.neutral_frame)
