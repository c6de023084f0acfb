"""Devices: numpy always, others only where their library is, and a word about which is missing."""

import importlib
import sys
import types

import array_api_strict
import numpy as np
import pytest

from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of, open_device


def test_the_processor_is_numpy_and_copies_nothing() -> None:
    values = np.arange(6.0).reshape(2, 3)
    assert open_device() is open_device("cpu") is CPU
    assert CPU.put(values) is values
    assert CPU.fetch(values) is values
    assert namespace_of(values) is np
    assert CPU.put(values, dtype="float32").dtype == np.float32


def test_arrays_of_another_library_come_back_as_they_went() -> None:
    device = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
    values = np.arange(6.0, dtype=np.float32).reshape(2, 3)
    values.flags.writeable = False
    there = device.put(values)
    assert namespace_of(there) is not np
    assert there.dtype == array_api_strict.float32
    assert np.array_equal(device.fetch(there), values)
    assert device.fetch(device.put(values, dtype="float64")).dtype == np.float64


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:x", "cuda:-1", "", "cpu:0", "cudas", "CPU"])
def test_a_device_that_there_is_not_is_refused_with_those_there_are(name: str) -> None:
    with pytest.raises(ValueError, match=r"there are cpu, cuda, cuda:NUMBER and torch"):
        open_device(name)


def test_without_a_library_the_message_says_which_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for library in ("torch", "cupy"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        ValueError, match=r"torch is not installed .*cupy is not .*Use device 'cpu'"
    ):
        open_device("cuda:1")
    with pytest.raises(ValueError, match="pip install torch"):
        open_device("torch")


def test_a_card_beyond_those_there_are_is_refused_with_their_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    torch = types.ModuleType("torch")
    compatible = types.ModuleType("array_api_compat.torch")
    compatible.cuda = types.SimpleNamespace(  # type: ignore[attr-defined]
        is_available=lambda: True, device_count=lambda: 2
    )
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "cupy", None)
    monkeypatch.setitem(sys.modules, "array_api_compat.torch", compatible)
    assert open_device("cuda").device == "cuda:0"
    assert open_device("cuda:1").device == "cuda:1"
    with pytest.raises(ValueError, match="torch sees 2 cards"):
        open_device("cuda:2")


def test_torch_on_the_processor_computes_as_numpy_does() -> None:
    pytest.importorskip("torch", reason="torch is not installed; nothing here requires it")
    device = open_device("torch")
    values = np.random.default_rng(0).standard_normal((5, 4))
    there = device.put(values)
    xp = namespace_of(there)
    assert xp is importlib.import_module("array_api_compat.torch")
    summed = device.fetch(xp.sum(xp.exp(there), axis=0))
    assert np.allclose(summed, np.exp(values).sum(axis=0), rtol=1e-12)
