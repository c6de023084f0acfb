"""What tests of this folder train from the same references is trained once per run."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.remembered import remember

TRAINED = tuple(
    (f"tests.model.mapping.{name}", "train_mapping")
    for name in ("test_predict", "test_train", "test_uncertainty")
)
"""Tests of training itself, of its bits and of how its arrays lie in memory, call `train`."""


@pytest.fixture(scope="package", autouse=True)
def _trained_once(remembered_folder: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        remember(remembered_folder, TRAINED, patch.setattr)
        yield
