"""Hashes of inputs."""

from pathlib import Path

import pytest

from usdface.core.errors import InputError
from usdface.core.provenance import hash_files


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    # A folder in its place, as the superuser may read all files.
    with pytest.raises(InputError, match=r"test_a_file_\w+: cannot be read: .*; check its perm"):
        hash_files([tmp_path])
    with pytest.raises(InputError, match=r"gone\.usda: cannot be read: No such file"):
        hash_files([tmp_path / "gone.usda"])
