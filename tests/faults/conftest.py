"""The folder that all tests of faults begin with, and how they are shared out among cores."""

from collections.abc import Iterable

import pytest
from _pytest.mark.structures import ParameterSet

from tests.faults.world import World, build_world


def together(names: Iterable[str]) -> list[ParameterSet]:
    """Return parameters of a fixture whose tests one process does, with what the fixture made."""
    return [pytest.param(name, id=name, marks=pytest.mark.xdist_group(name)) for name in names]


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Every file that any step makes; read only."""
    return build_world(tmp_path_factory.mktemp("world"))
