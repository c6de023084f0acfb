"""The mouth that every model moves."""

import pytest

from tests.model.surface.mouth import Mouth, make_mouth


@pytest.fixture(scope="package")
def mouth() -> Mouth:
    return make_mouth()
