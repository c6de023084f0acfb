"""Multiquadrics move a sheet with a slit for a mouth, whose true motion is known."""

import numpy as np
import pytest

from tests.model.surface.mouth import Mouth, opening, rms
from usdface.core.errors import InputError
from usdface.model.surface import fit as surface_fit
from usdface.model.surface.rbf_surface import RbfSurface, fit_rbf_surface


def fit(mouth: Mouth, moved: np.ndarray, **options: object) -> RbfSurface:
    return fit_rbf_surface(mouth.distances(), moved, **options)  # type: ignore[arg-type]


def test_over_the_surface_errors_are_smaller_and_lips_part(mouth: Mouth) -> None:
    moved = mouth.markers()
    straight, blended = fit(mouth, moved, blend=0.0).deform(moved), fit(mouth, moved).deform(moved)
    assert rms(mouth, blended.mean) <= rms(mouth, straight.mean)
    true = opening(mouth, mouth.motion)
    assert opening(mouth, straight.mean) < 0.2 * true
    assert 0.8 * true < opening(mouth, blended.mean) < 1.05 * true
    assert blended.sd is None


def test_points_in_folds_follow_their_side(mouth: Mouth) -> None:
    moved = mouth.markers()
    with_folds, without = (fit(mouth, moved, folds=f).deform(moved).mean for f in (True, False))
    assert opening(mouth, with_folds) > opening(mouth, without)


def test_an_open_blend_is_chosen_by_leaving_markers_out(mouth: Mouth) -> None:
    moved = mouth.markers()[::5]
    chosen, given = (fit(mouth, moved, blend=blend) for blend in (None, 0.0))
    assert chosen.blend > 0
    assert chosen.diagnostics.left_out_rms_mm < given.diagnostics.left_out_rms_mm


def test_streaming_gives_what_deforming_gives_in_parts_that_stay_small(
    mouth: Mouth, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = mouth.markers(noise=0.3)
    fitted = fit(mouth, moved)
    whole = fitted.deform(moved).mean
    monkeypatch.setattr(surface_fit, "_FIELD_VALUES", 7 * fitted.point_count)
    parts = [part.mean for part in fitted.stream(moved)]
    assert max(map(len, parts)) == 7
    assert np.allclose(np.concatenate(parts), whole, atol=1e-5)


def test_no_frames_give_no_frames(mouth: Mouth) -> None:
    found = fit(mouth, mouth.markers()).deform(np.zeros((0, len(mouth.chosen), 3)))
    assert found.mean.shape == (0, len(mouth.points), 3)
    assert found.sd is None


def test_two_markers_at_one_place_are_refused(mouth: Mouth) -> None:
    distances = mouth.distances()
    distances.geodesic_between[:, 1] = distances.geodesic_between[:, 0]
    distances.geodesic_between[1] = distances.geodesic_between[0]
    distances.euclidean_between[:, 1] = distances.euclidean_between[:, 0]
    distances.euclidean_between[1] = distances.euclidean_between[0]
    with pytest.raises(InputError, match="markers 0 and 1 are 0 mm apart"):
        fit_rbf_surface(distances, mouth.markers())
