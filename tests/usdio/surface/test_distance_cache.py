"""Distances are read back as they were, for their own key only."""

from pathlib import Path

import numpy as np

from usdface.usdio.layers import read_provenance
from usdface.usdio.surface.distance_cache import CachedDistances, read_distances, write_distances
from usdface.usdio.validation import validate


def test_distances_are_read_back_bit_for_bit_in_their_precision(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "toPoints": rng.random((5, 40)).astype(np.float32),
        "between": rng.random((5, 5)),
        "unreached": rng.random(40) > 0.5,
    }
    path = tmp_path / "d.usdc"
    write_distances(path, CachedDistances(arrays, {"islands": 3}), key="one")
    again = read_distances(path, key="one")
    assert again is not None
    assert again.counts == {"islands": 3}
    for name, array in arrays.items():
        assert again.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(again.arrays[name], array)
    assert read_provenance(path) is not None
    assert not validate(path)


def test_another_key_a_torn_file_and_none_at_all_are_no_cache(tmp_path: Path) -> None:
    path = tmp_path / "d.usdc"
    assert read_distances(path, key="one") is None
    write_distances(path, CachedDistances({"a": np.zeros(3)}), key="one")
    assert read_distances(path, key="two") is None
    path.write_bytes(b"PXR-USDC torn")
    assert read_distances(path, key="one") is None
