"""A Gaussian process moves a sheet with a slit for a mouth, whose true motion is known."""

import numpy as np
import pytest

from benchmarks._surface_subjects import deviations_of_axes
from tests.model.surface.mouth import Mouth, opening, rms
from usdface.core.errors import InputError
from usdface.model.surface import fit as surface_fit
from usdface.model.surface import gp_surface
from usdface.model.surface.distance import surface_distances
from usdface.model.surface.gp_surface import GpOptions, GpSurface, fit_gp_surface
from usdface.model.surface.rbf_surface import fit_rbf_surface
from usdface.numerics.manifold.posterior_prediction import DualMoments
from usdface.numerics.surface.surface_places import places_at_points

CORNERS = np.array([[-60, -60, 0], [60, -60, 0], [-60, 60, 0], [60, 60, 0], [0, 60, 0]])


def fit(mouth: Mouth, moved: np.ndarray, **options: object) -> GpSurface:
    return fit_gp_surface(mouth.distances(), moved, GpOptions(**options))  # type: ignore[arg-type]


def test_without_noise_errors_are_no_larger_than_of_multiquadrics_and_lips_part(
    mouth: Mouth,
) -> None:
    moved = mouth.markers()
    rbf = fit_rbf_surface(mouth.distances(), moved).deform(moved)
    process = fit(mouth, moved, sampler="shared").deform(moved)
    assert rms(mouth, process.mean) <= rms(mouth, rbf.mean)
    true = opening(mouth, mouth.motion)
    assert 0.8 * true < opening(mouth, process.mean) < 1.05 * true


def test_lips_that_follow_their_side_have_smaller_errors_and_the_rest_no_larger(
    mouth: Mouth,
) -> None:
    moved = mouth.markers()
    with_folds, without = (
        fit(mouth, moved, sampler="shared", length_scale=40.0, folds=folds).deform(moved).mean
        for folds in (True, False)
    )
    assert opening(mouth, with_folds) > opening(mouth, without)
    lips = np.concatenate([mouth.upper, mouth.lower])
    errors = [np.square(mean - mouth.motion)[:, lips].mean() for mean in (with_folds, without)]
    assert errors[0] < 0.6 * errors[1]
    assert rms(mouth, with_folds) < 1.05 * rms(mouth, without)


@pytest.mark.parametrize("sampler", [pytest.param("hmc", marks=pytest.mark.slow), "shared"])
def test_noise_is_smoothed_and_95_percent_intervals_contain_95_percent(
    mouth: Mouth, sampler: str
) -> None:
    moved = mouth.markers(noise=0.5)
    rbf = fit_rbf_surface(mouth.distances(), moved).deform(moved)
    fitted = fit(mouth, moved, sampler=sampler)
    found = fitted.deform(moved)
    assert rms(mouth, found.mean) < 0.97 * rms(mouth, rbf.mean)
    of_axes = deviations_of_axes(fitted, moved)
    assert found.sd is not None
    np.testing.assert_allclose(np.sqrt((of_axes**2).mean(axis=2)), found.sd, rtol=1e-3)
    inside = np.abs(found.mean - mouth.motion) < 1.96 * of_axes
    assert 0.91 < inside.mean() < 0.99


def test_no_point_is_surer_than_all_markers_together(
    mouth: Mouth, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(basis: np.ndarray, moments: DualMoments) -> np.ndarray:
        return np.zeros((len(moments.constant), len(basis)), np.float32)

    moved = mouth.markers(noise=0.5)
    fitted = fit(mouth, moved, sampler="shared", length_scale=40.0, samples=20)
    monkeypatch.setattr(gp_surface, "predict_variance", nothing)
    found = fitted.deform(moved)
    assert found.sd is not None
    assert found.sd[:, mouth.chosen].min() > 0.2 * 0.5 / np.sqrt(len(mouth.chosen))


def test_few_markers_that_hold_still_do_not_tell_that_the_face_does(mouth: Mouth) -> None:
    corners = [int(np.abs(mouth.points - at).sum(axis=1).argmin()) for at in CORNERS]
    places = places_at_points(mouth.counts, mouth.indices, np.array(corners))
    distances = surface_distances(mouth.points, mouth.counts, mouth.indices, places)
    still = 0.05 * np.random.default_rng(0).standard_normal((len(mouth.motion), len(corners), 3))
    found = fit_gp_surface(distances, still, GpOptions(sampler="shared", samples=20)).deform(still)
    assert found.sd is not None
    lips = np.concatenate([mouth.upper, mouth.lower])
    assert found.sd[:, lips].min() > 0.5
    assert found.sd[:, corners].max() < 0.2


def test_a_frame_of_large_motion_is_less_certain_than_one_at_rest(mouth: Mouth) -> None:
    """Errors are in proportion to the motion, which is much alike in shape from frame to frame."""
    sizes = np.repeat([0.1, 2.0], 15)[:, None, None]
    moved, true = sizes * mouth.markers(), sizes * mouth.motion
    found = fit(mouth, moved, sampler="shared", length_scale=40.0).deform(moved)
    assert found.sd is not None
    error = np.sqrt(np.square(found.mean - true).mean(axis=2))
    for half in (slice(0, 15), slice(15, 30)):
        assert (error[half] ** 2).mean() < 1.5 * (found.sd[half] ** 2).mean()
    assert found.sd[15:].mean() > 1.5 * found.sd[:15].mean()


def test_a_jaw_that_few_markers_show_is_not_taken_for_their_noise(mouth: Mouth) -> None:
    middle = len(mouth.upper) // 2
    lips = [mouth.upper[middle], mouth.lower[middle]]
    corners = [int(np.abs(mouth.points - at).sum(axis=1).argmin()) for at in CORNERS]
    chosen = np.array([*lips, *corners])
    places = places_at_points(mouth.counts, mouth.indices, chosen)
    distances = surface_distances(mouth.points, mouth.counts, mouth.indices, places)
    moved = mouth.motion[:, chosen]
    found = fit_gp_surface(distances, moved, GpOptions(sampler="shared")).deform(moved)
    error = np.square(found.mean - mouth.motion)[:, lips].mean()
    assert error < 0.1 * np.square(mouth.motion[:, lips]).mean()


def test_lips_are_less_certain_than_the_markers_that_they_follow(mouth: Mouth) -> None:
    away = np.abs(mouth.points[mouth.chosen, 1] - mouth.points[mouth.upper[0], 1])
    rows = np.flatnonzero(away > 6.0)
    places = places_at_points(mouth.counts, mouth.indices, mouth.chosen[rows])
    distances = surface_distances(mouth.points, mouth.counts, mouth.indices, places)
    moved = mouth.markers(noise=0.1)[:, rows]
    found = fit_gp_surface(distances, moved, GpOptions(sampler="shared")).deform(moved)
    assert found.sd is not None
    lips = np.concatenate([mouth.upper[5:14], mouth.lower[5:14]])
    error = np.abs(found.mean - mouth.motion)[:, lips]
    assert (error < 1.645 * found.sd[:, lips, None]).mean() > 0.9
    assert found.sd[:, lips].mean() > 1.5 * found.sd.mean()


def test_the_published_covariance_and_samples_are_options(mouth: Mouth) -> None:
    moved = mouth.markers(noise=0.5)
    found = fit(mouth, moved, sampler="shared", covariance="published", samples=20, folds=False)
    assert found.diagnostics.clipped > 0
    assert found.shared is not None
    assert found.shared.shape == (20, 4)
    assert rms(mouth, found.deform(moved).mean) < 1.0


@pytest.mark.parametrize("sampler", ["hmc", "shared"])
def test_a_face_that_comes_again_moves_the_mesh_alike(mouth: Mouth, sampler: str) -> None:
    """Chance must not make the mesh jitter, wherever in a take a frame is."""
    moved = mouth.markers(noise=0.5)[:3]
    fitted = fit(mouth, moved, sampler=sampler, length_scale=40.0, samples=20)
    mean = fitted.deform(np.concatenate([moved, moved[::-1]])).mean
    np.testing.assert_allclose(mean[3:], mean[2::-1], atol=1e-3)


def test_diagnostics_of_the_sampler_show_that_it_mixed(mouth: Mouth) -> None:
    moved = mouth.markers(noise=0.3)
    for sampler, least, rhat in (("hmc", 150, 1.02), ("shared", 30, 1.1)):  # 4 chains of 50
        diagnostics = fit(mouth, moved, length_scale=40.0, sampler=sampler).diagnostics
        assert diagnostics.effective_samples >= least
        assert diagnostics.rhat < rhat
        assert 0.6 < diagnostics.acceptance < 1.0
        assert diagnostics.left_out_rms_mm < 1.5


def test_streaming_gives_what_deforming_gives_in_parts_that_stay_small(
    mouth: Mouth, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = mouth.markers(noise=0.3)
    fitted = fit(mouth, moved, sampler="shared", length_scale=40.0)
    long = np.tile(moved, (9, 1, 1))
    whole = fitted.deform(long)
    monkeypatch.setattr(surface_fit, "_FIELD_VALUES", 7 * fitted.point_count)
    parts = list(fitted.stream(long))
    assert max(len(part.mean) for part in parts) == 7
    assert np.allclose(np.concatenate([p.mean for p in parts]), whole.mean, atol=1e-4)
    sds = [p.sd for p in parts if p.sd is not None]
    assert np.allclose(np.concatenate(sds), whole.sd, atol=1e-3)


def test_the_same_take_moves_the_same_way_twice(mouth: Mouth) -> None:
    moved = mouth.markers(noise=0.3)[:6]
    first, again = (
        fit(mouth, moved, length_scale=40.0, samples=30).deform(moved) for _ in range(2)
    )
    assert np.array_equal(first.mean, again.mean)


def test_open_settings_are_chosen_by_leaving_markers_out(mouth: Mouth) -> None:
    moved = mouth.markers()[::5]
    chosen, given = (fit(mouth, moved, sampler="shared", blend=blend) for blend in (None, 0.0))
    assert chosen.diagnostics.left_out_rms_mm < given.diagnostics.left_out_rms_mm
    assert 0 < chosen.length_scale < 200


@pytest.mark.parametrize("sampler", ["hmc", "shared"])
def test_a_face_at_rest_stays_at_rest(mouth: Mouth, sampler: str) -> None:
    still = np.zeros((3, len(mouth.chosen), 3))
    found = fit(mouth, still, sampler=sampler, length_scale=40.0, samples=40).deform(still)
    assert np.abs(found.mean).max() < 1e-6
    assert np.isfinite(found.sd).all()


@pytest.mark.parametrize(
    ("shape", "value", "options", "message"),
    [
        ((2, 3, 3), 0.0, {}, "displacements must be"),
        ((2, -1, 3), np.nan, {}, "of 2 frames are not finite, the first is index 0"),
        ((0, -1, 3), 0.0, {}, "no frame to fit"),
        ((2, -1, 3), 1.0, {"blend": 1.5}, "0 to 1; got 1.5"),
        ((2, -1, 3), 1.0, {"length_scale": -1.0}, "length scale must be positive"),
    ],
)
def test_displacements_and_settings_that_cannot_be_are_refused(
    mouth: Mouth, shape: tuple[int, ...], value: float, options: dict[str, float], message: str
) -> None:
    sizes = tuple(len(mouth.chosen) if size < 0 else size for size in shape)
    with pytest.raises(InputError, match=message):
        fit(mouth, np.full(sizes, value), **options)


def test_no_frames_give_no_frames(mouth: Mouth) -> None:
    moved = mouth.markers()[:4]
    fitted = fit(mouth, moved, sampler="shared", length_scale=40.0)
    found = fitted.deform(np.zeros((0, len(mouth.chosen), 3)))
    assert found.mean.shape == (0, len(mouth.points), 3)
    assert found.sd is not None
    assert found.sd.shape == (0, len(mouth.points))


@pytest.mark.parametrize("method", ["gp", "rbf"])
def test_markers_that_vanish_follow_the_others_and_are_less_certain(
    mouth: Mouth, method: str
) -> None:
    """The last position of a vanished marker is no measurement."""
    moved = mouth.markers()
    seen = np.ones(moved.shape[:2], bool)
    seen[1:, ::7] = False
    held = np.where(seen[..., None], moved, 0.0)
    model = (
        fit(mouth, moved, sampler="shared", length_scale=40.0)
        if method == "gp"
        else fit_rbf_surface(mouth.distances(), moved)
    )
    found, trusted = model.deform(held, seen.astype(float)), model.deform(held)
    assert rms(mouth, found.mean) < 0.6 * rms(mouth, trusted.mean)
    assert np.allclose(found.mean[0], trusted.mean[0])
    if found.sd is not None and trusted.sd is not None:
        assert np.allclose(found.sd[0], trusted.sd[0])
        known = model.deform(moved)
        assert known.sd is not None
        assert (found.sd[1:] > 0.9 * known.sd[1:]).all()
        assert (found.sd[1:] > 1.1 * known.sd[1:]).mean() > 0.03
        filled = model.deform(moved, np.where(seen, 1.0, 0.5))
        assert np.array_equal(filled.mean, model.deform(moved).mean)
        assert np.allclose(filled.sd, found.sd, rtol=0.2)


def test_without_any_marker_the_face_rests(mouth: Mouth) -> None:
    moved = mouth.markers()
    model = fit(mouth, moved, sampler="shared", length_scale=40.0)
    found = model.deform(moved, np.zeros(moved.shape[:2]))
    assert np.abs(found.mean).max() < 1e-4
