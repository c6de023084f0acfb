"""A hybrid of markers whose blend is keyed: its ends are the parts, between them it is straight."""

from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.errors import InputError
from usdface.specs.map import MapSpec
from usdface.specs.train import TrainSpec
from usdface.steps.execute import execute
from usdface.usdio.mapping import read_mapping, write_mapping
from usdface.usdio.performance import read_weights


def mapped(shot: Shot, mapping: str, out: str, **more: object) -> np.ndarray:
    spec = MapSpec(
        take=shot / "shot.clean.take.usda",
        mapping=shot / mapping,
        rig=shot / "hero.usdc",
        out=shot / out,
        frames="20-120",
        **more,  # type: ignore[arg-type]
    )
    execute(spec)
    return read_weights(shot / out).values


def keys(shot: Shot, text: str) -> Path:
    (shot / "alpha.csv").write_text(f"frame,alpha\n{text}")
    return shot / "alpha.csv"


def test_alpha_runs_from_one_part_to_the_other(shot: Shot) -> None:
    references = shot / "hero.references.usda"
    execute(TrainSpec(references=references, out=shot / "h.usdc", method="hybrid", dimensions=16))
    hybrid = read_mapping(shot / "h.usdc")
    parts = []
    for share in (0.0, 1.0):
        settings = hybrid.settings | {"alpha": share}
        write_mapping(shot / "part.usdc", type(hybrid)(**{**vars(hybrid), "settings": settings}))
        parts.append(mapped(shot, "part.usdc", f"part{share:g}.usda"))
    blended = mapped(shot, "h.usdc", "keyed.usda", alpha=keys(shot, "20,0\n120,1\n"))
    share = np.linspace(0, 1, 101)[:, None]
    expected = (1 - share) * parts[0] + share * parts[1]
    np.testing.assert_allclose(blended, expected, atol=1e-6)
    assert np.abs(parts[1] - parts[0]).max() > 0.01


def test_what_is_no_hybrid_has_nothing_to_blend(shot: Shot) -> None:
    with pytest.raises(InputError, match="train with --method hybrid"):
        mapped(shot, "hero.mapping.usdc", "keyed.usda", alpha=keys(shot, "1,0.5\n"))
