"""Placements that end where they began."""

import pytest

from usdface.model.placement import place
from usdface.numerics.registration import cloud_alignment, motion_search


@pytest.fixture
def placed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Place markers without removing errors of poses, where a test is not of these."""
    monkeypatch.setattr(place, "_POSE_ROUNDS", 0)


@pytest.fixture
def two_pose_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove all rigid motion, then the errors of poses that the placement tells, once."""
    monkeypatch.setattr(place, "_POSE_ROUNDS", 2)


@pytest.fixture
def few_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search by shape and by motion from few starts, where a test is not of their breadth."""
    search_from_few_starts(monkeypatch)


def search_from_few_starts(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(cloud_alignment, "_YAWS_DEGREES", range(0, 360, 90))
    patch.setattr(cloud_alignment, "_PITCHES_DEGREES", (0,))
    patch.setattr(motion_search, "_PITCHES_DEGREES", (-15.0, 0.0, 15.0))
    patch.setattr(motion_search, "_SCALES", (0.9, 1.05))
    patch.setattr(motion_search, "_HEIGHTS", (-0.2, 0.0, 0.2))
    patch.setattr(motion_search, "_CLIMBED_COUNT", 2)
