"""Both demo heads, built once for all tests that only look at them."""

import pytest

from usdface.demo.acting import ActedPerformance, performance
from usdface.demo.head import DemoHead
from usdface.demo.rig import make_head
from usdface.demo.sculpt import ACTOR, CHARACTER


@pytest.fixture(scope="session")
def character() -> DemoHead:
    return make_head(CHARACTER)


@pytest.fixture(scope="session")
def actor() -> DemoHead:
    return make_head(ACTOR)


@pytest.fixture(scope="session", params=["character", "actor"])
def head(request: pytest.FixtureRequest) -> DemoHead:
    found: DemoHead = request.getfixturevalue(request.param)
    return found


@pytest.fixture(scope="session")
def acted() -> ActedPerformance:
    return performance()
