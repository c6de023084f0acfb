"""Markers move a sheet with a slit for a mouth, whose true motion is known."""

from dataclasses import dataclass, replace

import array_api_strict
import numpy as np
import pytest

from tests.numerics.surface.test_geodesic import quad_grid
from usdface.core.errors import InputError
from usdface.model.surface.fit import (
    SurfaceDistances,
    fit_surface_regression,
    surface_distances,
)
from usdface.numerics.array_namespace import ArrayDevice
from usdface.numerics.registration.surface_places import SurfacePlaces, places_at_points

ROWS, COLUMNS, STEP = 31, 31, 4.0
SLIT = 15


@dataclass(frozen=True)
class Mouth:
    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    places: SurfacePlaces
    chosen: np.ndarray
    motion: np.ndarray
    """(frames, points, 3): what every point does."""
    upper: np.ndarray
    lower: np.ndarray

    def distances(self, **options: str) -> SurfaceDistances:
        return surface_distances(
            self.points,
            self.counts,
            self.indices,
            self.places.faces,
            self.places.weights,
            marker_corners=self.places.corners,
            **options,  # type: ignore[arg-type]
        )

    def markers(self, noise: float = 0.0) -> np.ndarray:
        rng = np.random.default_rng(5)
        clean = self.motion[:, self.chosen]
        return clean + noise * rng.standard_normal(clean.shape)


@pytest.fixture(scope="module")
def mouth() -> Mouth:
    points, counts, indices = quad_grid(ROWS, COLUMNS, step=STEP)
    points = points - points.mean(axis=0)
    upper = SLIT * COLUMNS + np.arange(6, 25)
    lower = len(points) + np.arange(len(upper))
    quads = indices.reshape(-1, 4).copy()
    below = points[quads].mean(axis=1)[:, 1] < points[upper[0], 1]
    for old, new in zip(upper, lower, strict=True):
        quads[below] = np.where(quads[below] == old, new, quads[below])
    whole = np.concatenate([points, points[upper]])
    y, x = whole[:, 1] - points[upper[0], 1], whole[:, 0]
    under = y < 0
    under[lower] = True
    jaw = under * np.maximum(0, 1 - (x / 42) ** 2) * np.exp(-0.5 * (np.minimum(y, 0) / 45) ** 2)
    smile = np.exp(-0.5 * (((np.abs(x) - 40) / 18) ** 2 + (y / 18) ** 2))
    brow = np.exp(-0.5 * (((x - 10) / 25) ** 2 + ((y - 45) / 14) ** 2))
    shapes = np.zeros((3, len(whole), 3))
    shapes[0, :, 1], shapes[0, :, 2] = -14 * jaw, -3 * jaw
    shapes[1, :, 0], shapes[1, :, 1] = 5 * smile * np.sign(x), 5 * smile
    shapes[2, :, 1] = 6 * brow
    weights = np.clip(np.random.default_rng(2).uniform(-0.3, 1, (30, 3)), 0, 1)
    motion = np.einsum("fs,spc->fpc", weights, shapes)
    grid = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    chosen = grid[1::4, 1::4].ravel()
    lips = np.concatenate([grid[SLIT + 1, 7:25:4], grid[SLIT - 1, 7:25:4]])
    chosen = np.unique(np.concatenate([chosen, lips]))
    places = places_at_points(counts, quads.ravel(), chosen)
    return Mouth(whole, counts, quads.ravel(), places, chosen, motion, upper, lower)


def rms(mouth: Mouth, mean: np.ndarray) -> float:
    unseen = np.setdiff1d(np.arange(len(mouth.points)), mouth.chosen)
    return float(np.sqrt(((mean - mouth.motion)[:, unseen] ** 2).mean()))


def opening(mouth: Mouth, motion: np.ndarray) -> float:
    middle = slice(5, 14)
    parted = motion[:, mouth.upper[middle], 1] - motion[:, mouth.lower[middle], 1]
    return float(parted.mean())


def test_over_the_surface_errors_are_smaller_and_lips_part(mouth: Mouth) -> None:
    distances, moved = mouth.distances(), mouth.markers()
    straight = fit_surface_regression(distances, moved, method="rbf", blend=0.0).deform(moved)
    rbf = fit_surface_regression(distances, moved, method="rbf").deform(moved)
    process = fit_surface_regression(distances, moved, sampler="map", blend=0.39).deform(moved)
    assert rms(mouth, process.mean) <= rms(mouth, rbf.mean) <= rms(mouth, straight.mean)
    true = opening(mouth, mouth.motion)
    assert opening(mouth, straight.mean) < 0.2 * true
    assert 0.8 * true < opening(mouth, process.mean) < 1.05 * true
    assert 0.8 * true < opening(mouth, rbf.mean) < 1.05 * true
    assert rbf.sd is None


def test_lips_that_follow_their_side_are_nearer_to_the_truth_and_the_rest_is_no_farther(
    mouth: Mouth,
) -> None:
    distances, moved = mouth.distances(), mouth.markers()
    with_folds, without = (
        fit_surface_regression(distances, moved, sampler="shared", length_scale=40.0, folds=folds)
        .deform(moved)
        .mean
        for folds in (True, False)
    )
    assert opening(mouth, with_folds) > opening(mouth, without)
    lips = np.concatenate([mouth.upper, mouth.lower])
    errors = [np.square(mean - mouth.motion)[:, lips].mean() for mean in (with_folds, without)]
    assert errors[0] < 0.6 * errors[1]
    assert rms(mouth, with_folds) < 1.05 * rms(mouth, without)


@pytest.mark.parametrize("sampler", [pytest.param("hmc", marks=pytest.mark.slow), "map", "shared"])
def test_noise_is_smoothed_and_intervals_hold_what_they_say(mouth: Mouth, sampler: str) -> None:
    distances, moved = mouth.distances(), mouth.markers(noise=0.5)
    rbf = fit_surface_regression(distances, moved, method="rbf").deform(moved)
    fitted = fit_surface_regression(distances, moved, sampler=sampler)  # type: ignore[arg-type]
    found = fitted.deform(moved, of_axes=True)
    assert rms(mouth, found.mean) < 0.97 * rms(mouth, rbf.mean)
    assert found.sd_of_axes is not None
    inside = np.abs(found.mean - mouth.motion) < 1.96 * found.sd_of_axes
    assert 0.91 < inside.mean() < 0.99


def test_the_sampler_says_how_well_it_mixed(mouth: Mouth) -> None:
    moved = mouth.markers(noise=0.3)
    said = fit_surface_regression(mouth.distances(), moved, length_scale=40.0).diagnostics
    assert said.effective_samples >= 150
    assert said.rhat < 1.02
    assert 0.7 < said.acceptance < 0.9
    assert said.left_out_rms_mm < 1.5


def test_streaming_gives_what_deforming_gives_in_parts_that_stay_small(mouth: Mouth) -> None:
    moved = mouth.markers(noise=0.3)
    fitted = fit_surface_regression(mouth.distances(), moved, sampler="map", length_scale=40.0)
    long = np.tile(moved, (9, 1, 1))
    whole = fitted.deform(long)
    heard: list[float] = []
    parts = list(fitted.stream(long, frames_per_part=7, progress=lambda f, _: heard.append(f)))
    assert max(len(part.mean) for part in parts) == 7
    assert np.allclose(np.concatenate([p.mean for p in parts]), whole.mean, atol=1e-4)
    sds = [p.sd for p in parts if p.sd is not None]
    assert np.allclose(np.concatenate(sds), whole.sd, atol=1e-3)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0


def test_the_same_take_moves_the_same_way_twice(mouth: Mouth) -> None:
    moved, distances = mouth.markers(noise=0.3)[:6], mouth.distances()
    first, again = (
        fit_surface_regression(distances, moved, length_scale=40.0, samples=30).deform(moved)
        for _ in range(2)
    )
    assert np.array_equal(first.mean, again.mean)


def test_settings_that_are_left_open_are_chosen_by_leaving_markers_out(mouth: Mouth) -> None:
    moved, distances = mouth.markers()[::5], mouth.distances()
    chosen = fit_surface_regression(distances, moved, sampler="map", blend=None)
    given = fit_surface_regression(distances, moved, sampler="map", blend=0.0)
    assert chosen.diagnostics.left_out_rms_mm <= given.diagnostics.left_out_rms_mm
    assert 0 < chosen.length_scale < 200


def test_a_face_at_rest_stays_at_rest(mouth: Mouth) -> None:
    still = np.zeros((3, len(mouth.chosen), 3))
    for sampler in ("hmc", "map", "shared"):
        fitted = fit_surface_regression(
            mouth.distances(), still, sampler=sampler, length_scale=40.0, samples=40
        )
        found = fitted.deform(still)
        assert np.abs(found.mean).max() < 1e-6
        assert np.isfinite(found.sd).all()


def test_no_frames_give_no_frames(mouth: Mouth) -> None:
    fitted = fit_surface_regression(mouth.distances(), mouth.markers(), method="rbf")
    assert fitted.deform(np.zeros((0, len(mouth.chosen), 3))).mean.shape[0] == 0


def test_an_island_without_a_marker_follows_by_straight_lines_and_is_told(mouth: Mouth) -> None:
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
    assert "9 of 989 points lie on 1 islands" in distances.unreached.describe()[0]
    found = fit_surface_regression(distances, mouth.markers(), sampler="map").deform(
        mouth.markers()
    )
    assert np.isfinite(found.mean).all()


def test_a_sheet_without_faults_has_nothing_to_tell(mouth: Mouth) -> None:
    assert mouth.distances().unreached.describe() == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"marker_faces": [0, 1, 2], "marker_barycentrics": np.eye(3)}, "at least 4 are needed"),
        ({"face_counts": [], "face_indices": []}, "no face"),
        ({"marker_faces": [0, 1, 2, 99]}, "marker 3 sits on face 99"),
        ({"marker_barycentrics": np.full((4, 3), 0.9)}, "marker 0 is not on its face"),
        ({"points": np.zeros((5, 16, 3))}, "one rest pose"),
        ({"points": np.full((16, 3), np.nan)}, "not finite"),
    ],
)
def test_meshes_and_bindings_that_cannot_be_are_refused(
    change: dict[str, object], message: str
) -> None:
    points, counts, indices = quad_grid(4, 4)
    given = {
        "points": points,
        "face_counts": counts,
        "face_indices": indices,
        "marker_faces": [0, 2, 6, 8],
        "marker_barycentrics": np.tile([0.2, 0.3, 0.5], (4, 1)),
    } | change
    with pytest.raises(InputError, match=message):
        surface_distances(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("moved", "options", "message"),
    [
        (np.zeros((2, 3, 3)), {}, "displacements must be"),
        (np.full((2, 74, 3), np.nan), {}, "of 2 frames are not finite, the first is index 0"),
        (np.zeros((0, 74, 3)), {}, "no frame to fit"),
        (np.ones((2, 74, 3)), {"blend": 1.5}, "0 to 1; got 1.5"),
        (np.ones((2, 74, 3)), {"length_scale": -1.0}, "length scale must be positive"),
    ],
)
def test_displacements_and_settings_that_cannot_be_are_refused(
    mouth: Mouth, moved: np.ndarray, options: dict[str, float], message: str
) -> None:
    fitting = moved if moved.shape[1] == 3 else np.zeros((len(moved), len(mouth.chosen), 3))
    if np.isnan(moved).any():
        fitting[:] = np.nan
    with pytest.raises(InputError, match=message):
        fit_surface_regression(mouth.distances(), fitting, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("sampler", ["hmc", "map", "shared"])
def test_every_device_moves_the_mesh_alike(mouth: Mouth, sampler: str) -> None:
    """array_api_strict refuses whatever torch or cupy need not have."""
    moved = mouth.markers(noise=0.5)[:6]
    options = {"sampler": sampler, "length_scale": 40.0, "samples": 20, "precision": "double"}
    here = fit_surface_regression(mouth.distances(), moved, **options)  # type: ignore[arg-type]
    strict = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
    assert here.fields is not None
    basis, squares, reading = (
        strict.put(each) for each in (here.fields.basis, here.fields.squares, here.fields.reading)
    )
    there = replace(
        here,
        device=strict,
        fields=replace(here.fields, basis=basis, squares=squares, reading=reading, device=strict),
    )
    one, other = here.deform(moved, of_axes=True), there.deform(moved, of_axes=True)
    for name in ("mean", "sd", "sd_of_axes"):
        assert np.abs(getattr(one, name) - getattr(other, name)).max() < 1e-6


@pytest.mark.parametrize("sampler", ["hmc", "map", "shared"])
def test_torch_moves_the_mesh_as_numpy_does(mouth: Mouth, sampler: str) -> None:
    pytest.importorskip("torch", reason="torch is not installed; nothing here requires it")
    moved = mouth.markers(noise=0.5)[:6]
    options = {"sampler": sampler, "length_scale": 40.0, "samples": 20, "precision": "double"}
    one, other = (
        fit_surface_regression(
            mouth.distances(),
            moved,
            device=device,
            **options,  # type: ignore[arg-type]
        ).deform(moved)
        for device in ("cpu", "torch")
    )
    assert np.abs(one.mean - other.mean).max() < 1e-6
    assert np.abs(one.sd - other.sd).max() < 1e-6


def test_a_device_that_is_not_there_is_refused_before_anything_is_fitted(mouth: Mouth) -> None:
    with pytest.raises(InputError, match="there are cpu, cuda, cuda:NUMBER and torch"):
        fit_surface_regression(mouth.distances(), mouth.markers(), device="quantum")
