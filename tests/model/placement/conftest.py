"""Placements that end where they began."""

import pytest

from usdface.model.placement import place
from usdface.numerics.registration import motion_search


@pytest.fixture
def placed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Place markers without removing errors of poses, where a test is not of these."""
    monkeypatch.setattr(place, "_POSE_ROUNDS", 0)


@pytest.fixture
def few_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search by motion from few starts, where a test is not of the search's breadth."""
    monkeypatch.setattr(motion_search, "_PITCHES_DEGREES", (-15.0, 0.0, 15.0))
    monkeypatch.setattr(motion_search, "_SCALES", (0.9, 1.05))
    monkeypatch.setattr(motion_search, "_HEIGHTS", (-0.2, 0.0, 0.2))
    monkeypatch.setattr(motion_search, "_CLIMBED_COUNT", 2)
