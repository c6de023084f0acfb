"""Multiquadrics against the markers that they meet, and against scipy."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.spatial.distance import cdist

from usdface.numerics.manifold.surface_fields import (
    fit_distance_multiquadric,
    multiquadric_fields,
    nearest_stiffness,
)


def test_multiquadrics_meet_every_marker_and_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    places, points = rng.standard_normal((15, 3)), rng.standard_normal((40, 3))
    moved = rng.standard_normal((15, 2))
    stiffness = np.full(15, 0.7)
    inverse = fit_distance_multiquadric(cdist(places, places), stiffness)
    ours = multiquadric_fields(inverse, stiffness, cdist(places, points)) @ moved
    theirs = RBFInterpolator(places, moved, kernel="multiquadric", epsilon=1 / 0.7, degree=-1)
    assert np.allclose(ours, theirs(points), atol=1e-3)
    assert np.allclose(
        multiquadric_fields(inverse, stiffness, cdist(places, places)) @ moved, moved, atol=1e-3
    )


def test_two_markers_at_one_place_are_named() -> None:
    places = np.random.default_rng(0).standard_normal((6, 3))
    places[4] = places[1]
    between = cdist(places, places)
    with pytest.raises(ValueError, match="markers 1 and 4 are 0 mm apart"):
        fit_distance_multiquadric(between, nearest_stiffness(between))
