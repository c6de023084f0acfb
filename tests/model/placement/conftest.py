"""Placements that end where they began."""

import pytest

from usdface.model.placement import place


@pytest.fixture
def placed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Place markers without removing errors of poses, where a test is not of these."""
    monkeypatch.setattr(place, "_POSE_ROUNDS", 0)
