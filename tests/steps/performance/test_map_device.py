"""Weights predicted elsewhere than on the processor."""

import sys
from pathlib import Path

import array_api_strict
import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.numerics.array_namespace import ArrayDevice
from usdface.specs.performance import MapSpec
from usdface.steps.performance import map as map_step
from usdface.usdio.performance.read import read_performance


def mapped(shot: Shot, out: Path, device: str) -> np.ndarray:
    map_step.run(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / "hero.usdc",
            out=out,
            device=device,
        )
    )
    return read_performance(out).weights.values


def test_a_performance_is_the_same_to_a_millionth_on_every_device(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = mapped(finished_shot, tmp_path / "here.usda", "cpu")
    strict = ArrayDevice("cuda", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
    monkeypatch.setattr(map_step, "open_device", lambda name: strict)
    there = mapped(finished_shot, tmp_path / "there.usda", "cuda")
    np.testing.assert_allclose(there, here, atol=1e-6)


def test_a_device_that_cannot_be_had_is_refused_before_anything_is_written(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for library in ("torch", "cupy"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=r"map --device: device 'cuda' cannot be used: torch is"):
        mapped(finished_shot, tmp_path / "x.usda", "cuda")
    assert not list(tmp_path.iterdir())
