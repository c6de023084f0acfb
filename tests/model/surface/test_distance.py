"""Distances over a sheet: islands, and meshes that cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from tests.model.surface.mouth import Mouth
from tests.numerics.surface.test_geodesic import quad_grid
from usdface.core.errors import InputError
from usdface.model.surface.distance import surface_distances
from usdface.model.surface.gp_surface import GpOptions, fit_gp_surface
from usdface.numerics.surface.surface_places import SurfacePoints, places_at_points


def test_an_island_without_a_marker_follows_by_straight_lines_and_is_reported(mouth: Mouth) -> None:
    points, counts, indices = quad_grid(3, 3)
    far = points + np.array([0.0, 0.0, -9.0])
    start = len(mouth.points)
    two = replace(
        mouth,
        points=np.concatenate([mouth.points, far]),
        counts=np.concatenate([mouth.counts, counts]),
        indices=np.concatenate([mouth.indices, indices + start]),
    )
    distances = two.distances()
    assert distances.unreached.points[start:].all()
    assert not distances.unreached.points[:start].any()
    assert distances.unreached.islands_without_marker == 1
    assert np.array_equal(
        distances.geodesic_to_points[:, start:], distances.euclidean_to_points[:, start:]
    )
    assert "9 of 989 points are on 1 separate part without" in distances.unreached.describe([])[0]
    options = GpOptions(sampler="shared")
    found = fit_gp_surface(distances, mouth.markers(), options).deform(mouth.markers())
    assert np.isfinite(found.mean).all()
    assert found.sd is not None
    assert (found.sd[:, start:].min(axis=1) > 1.5 * np.median(found.sd[:, :start], axis=1)).all()


def test_the_markers_on_the_smaller_of_two_parts_are_named(mouth: Mouth) -> None:
    points, counts, indices = quad_grid(3, 3)
    chosen = np.concatenate([mouth.chosen, [len(mouth.points) + 4]])
    two = replace(
        mouth,
        points=np.concatenate([mouth.points, points + np.array([0.0, 0.0, -9.0])]),
        counts=np.concatenate([mouth.counts, counts]),
        indices=np.concatenate([mouth.indices, indices + len(mouth.points)]),
    )
    two = replace(two, places=places_at_points(two.counts, two.indices, chosen))
    names = [f"m{number}" for number in range(len(chosen))]
    (told,) = two.distances().unreached.describe(names)
    assert f"parts than most markers: 1 marker, {names[-1]};" in told


def test_a_sheet_without_faults_has_nothing_to_report(mouth: Mouth) -> None:
    assert mouth.distances().unreached.describe([]) == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": np.arange(3)}, "at least 4 are needed"),
        ({"face_counts": np.zeros(0, int), "face_indices": np.zeros(0, int)}, "no face"),
        ({"faces": np.array([0, 2, 6, 99])}, "marker 3 sits on face 99"),
        ({"weights": np.full((4, 3), 0.9)}, "marker 0 is not on its face"),
        ({"points": np.zeros((5, 16, 3))}, "one rest pose"),
        ({"points": np.full((16, 3), np.nan)}, "not finite"),
    ],
)
def test_meshes_and_bindings_that_cannot_be_are_refused(
    change: dict[str, np.ndarray], message: str
) -> None:
    points, counts, indices = quad_grid(4, 4)
    faces = change.get("faces", np.array([0, 2, 6, 8]))
    corners = indices.reshape(-1, 4)[np.array([0, 2, 6, 8]), :3]
    weights = change.get("weights", np.tile([0.2, 0.3, 0.5], (4, 1)))
    with pytest.raises(InputError, match=message):
        surface_distances(
            change.get("points", points),
            change.get("face_counts", counts),
            change.get("face_indices", indices),
            SurfacePoints(faces, corners, weights),
        )
