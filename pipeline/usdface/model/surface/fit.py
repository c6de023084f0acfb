"""Markers move any mesh: W06's regression over the surface, fitted once for a take."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.model.surface.choice import choose_settings, marker_spectrum
from usdface.model.surface.diagnostics import SurfaceDiagnostics, sample_twice
from usdface.model.surface.distance import (
    BLEND,
    FEWEST_MARKERS,
    SurfaceDistances,
    UnreachedReport,
    surface_distances,
)
from usdface.model.surface.motion import (
    DTYPES,
    SAMPLES,
    Method,
    Precision,
    Sampler,
    SurfaceMotion,
    SurfaceRegression,
    check_displacements,
    rows_of_axes,
)
from usdface.numerics.array_namespace import open_device
from usdface.numerics.manifold.fold_sides import FoldSides, find_fold_sides
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.manifold.hyper_sampling import find_modes
from usdface.numerics.manifold.left_out import calibrate_spread, leave_markers_out
from usdface.numerics.manifold.multiquadric import fit_distance_multiquadric, multiquadric_fields
from usdface.numerics.manifold.posterior_prediction import make_fields
from usdface.numerics.manifold.shared_posterior import sample_shared
from usdface.numerics.manifold.surface_covariance import Shape
from usdface.numerics.manifold.tabulated_energy import SharedTable

__all__ = [
    "BLEND",
    "FEWEST_MARKERS",
    "SurfaceDiagnostics",
    "SurfaceDistances",
    "SurfaceMotion",
    "SurfaceRegression",
    "UnreachedReport",
    "fit_surface_regression",
    "surface_distances",
]

_THINNED = 10  # samples of each chain by which intervals are calibrated


def fit_surface_regression(
    distances: SurfaceDistances,
    displacements: FloatArray,
    *,
    method: Method = "gp",
    sampler: Sampler = "hmc",
    blend: float | None = BLEND,
    length_scale: float | None = None,
    covariance_shape: Shape = "creased",
    prior: HyperPrior | None = None,
    folds: bool = True,
    samples: int = SAMPLES,
    seed: int = 0,
    device: str = "cpu",
    precision: Precision = "single",
) -> SurfaceRegression:
    """Fit a regression from markers to a surface.

    Parameters
    ----------
    distances : SurfaceDistances
    displacements : (frames, markers, 3) float array
        A take's, or frames spread over it, from the neutral frame [mm]. Settings are chosen on
        them; every frame is regressed by itself later.
    method : {'gp', 'rbf'}
        A Gaussian process under eq. 7, or multiquadrics.
    sampler : {'hmc', 'map', 'shared'}
        Hyper-parameters of each frame and axis by Hybrid Monte Carlo; by their mode and the
        Gaussian around it; or by one sample of them for the whole take.
    blend : float or None
        Share of the geodesic distance [0-1]; None chooses it by leaving markers out.
    length_scale : float, optional
        [mm]; by default chosen by leaving markers out.
    covariance_shape : {'creased', 'squared-exponential'}
        The second is eq. 7 as published.
    prior : HyperPrior, optional
    folds : bool
        Whether points in folds, such as the insides of lips, follow the markers of their own
        side; never where the distance is Euclidean (`blend` 0), which knows no sides.
    samples : int
    seed : int
        Of every random choice: the same take moves the same way each time.
    device : str
        Where frames are sampled and predicted, as `open_device` names it. Settings are chosen on
        the processor.
    precision : {'single', 'double'}
        Of sampling and prediction. In double precision every device does the same to 1e-6 mm.

    Raises
    ------
    InputError
        If displacements do not fit the markers or are not finite, two markers sit at one place, or
        there is no such device.
    """
    count = len(distances.marker_positions)
    moved = check_displacements(displacements, count)
    if not len(moved):
        raise InputError("no frame to fit the regression to; give the take's displacements")
    if blend is not None and not 0 <= blend <= 1:
        raise InputError(f"blend is the geodesic distance's share, 0 to 1; got {blend}")
    try:
        there = open_device(device)
        chosen = choose_settings(
            distances,
            moved,
            method=method,
            blend=blend,
            length_scale=length_scale,
            shape=covariance_shape,
            prior=prior,
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    points = distances.points
    between = distances.blended_between(chosen.blend)
    to_points = distances.blended_to_points(chosen.blend)
    sides = _sides(distances) if folds and chosen.blend > 0 else None
    if method == "rbf":
        operator = multiquadric_fields(fit_distance_multiquadric(between), to_points)
        if sides is not None:
            sides.apply(operator, np.eye(count))
        return SurfaceRegression(
            method=method,
            sampler=sampler,
            blend=chosen.blend,
            length_scale=0.0,
            diagnostics=SurfaceDiagnostics(0.0, chosen.left_out_rms_mm),
            marker_count=count,
            point_count=len(points),
            operator=operator,
        )
    spectrum, covariance = marker_spectrum(
        distances, chosen.blend, chosen.length_scale, shape=covariance_shape, prior=prior
    )
    table = SharedTable(spectrum)
    rng = np.random.default_rng(seed)
    cross = covariance.cross(to_points)
    places = distances.scaled(points).astype(np.float32)
    if sides is not None:
        sides.apply(cross, covariance.matrix())
        sides.apply(places, distances.scaled(distances.marker_positions))
    fields = make_fields(spectrum, cross, places, rng=rng, device=there, dtype=DTYPES[precision])
    rows = rows_of_axes(chosen.frames)
    shared = None
    facts: dict[str, float] = {}
    if sampler == "shared":
        shared = sample_shared(rng, table, rows, keep=samples)
        theta = shared.theta[:, :, None]
        facts["acceptance"] = shared.acceptance
    elif sampler == "map":
        theta = find_modes(table, rows).theta[None]
    else:
        theta, facts = sample_twice(
            rng, table, rows, keep=samples, device=there, dtype=DTYPES[precision]
        )
    thin = max(1, len(theta) // _THINNED)
    left_out = leave_markers_out(spectrum, rows, theta[::thin], with_nearest=True)
    return SurfaceRegression(
        method=method,
        sampler=sampler,
        blend=chosen.blend,
        length_scale=chosen.length_scale,
        diagnostics=SurfaceDiagnostics(covariance.clipped, chosen.left_out_rms_mm, **facts),
        marker_count=count,
        point_count=len(points),
        widening=calibrate_spread(left_out, covariance.matrix(), cross),
        table=table,
        fields=fields,
        shared=shared,
        samples=samples,
        seed=seed,
        device=there,
        precision=precision,
    )


def _sides(distances: SurfaceDistances) -> FoldSides:
    markers = distances.marker_positions
    return find_fold_sides(
        distances.geodesic_to_points,
        distances.euclidean_to_points,
        spread=float((markers - markers.mean(axis=0)).std()),
    )
