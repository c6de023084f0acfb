"""The folder that all tests of faults begin with."""

import pytest

from tests.faults.world import World, build_world


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Every file that any step makes; read only."""
    return build_world(tmp_path_factory.mktemp("world"))
