"""The papers' equations, compared with independent implementations.

D06 is Deng et al. (2006), S11 Song et al. (2011), W06 Wang et al. (2006). The difference of two
results is the largest over all entries, divided by the largest entry. Rows above 1e-6 give the
reason.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.optimize import lsq_linear, nnls
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from tests.model.surface.mouth import Mouth, make_mouth
from tests.numerics.manifold.small_process import (
    dense_covariance,
    dense_energy,
    dense_parts,
    direct_moments,
    draw_rows,
    small_spectrum,
)
from usdface.model.retarget.face_correspondence import RIDGE_SHARE, Correspondence, match_positions
from usdface.model.surface.distance import BLEND_PUBLISHED
from usdface.numerics.manifold.hyper_posterior import SharedTable, energy_of_moments
from usdface.numerics.manifold.hyper_sampling import sample_hyperparameters
from usdface.numerics.manifold.posterior_prediction import average_dual_weights
from usdface.numerics.manifold.surface_fields import (
    fit_covariance,
    fit_distance_multiquadric,
    multiquadric_fields,
    nearest_stiffness,
)
from usdface.numerics.motion.laplacian_warp import Insertion, warp_motion
from usdface.numerics.motion.sequence_search import find_published, starts_within
from usdface.numerics.regression.kernel_cca import (
    KernelCCA,
    fit_kernel_cca,
    predict_expansion,
)
from usdface.numerics.regression.multiquadric_rbf import fit_multiquadric, predict_multiquadric
from usdface.numerics.regression.pca import fit_pca, project
from usdface.numerics.regression.rbf_ridge import (
    centre_widths,
    fit_rbf_ridge,
    gaussian_design,
    predict_rbf_ridge,
    reestimate_ridge,
    rotate,
)
from usdface.numerics.rigid.rigid_alignment import align_rigid
from usdface.numerics.solve.banded_smoothing import apply_filter_bank
from usdface.numerics.solve.blendshape_equation import solve_least_squares, solve_weights
from usdface.speech.phones import VISEME_PHONES

EXACT_SHARE = 1e-6
"""Relative difference above which a row needs a reason."""

TABLE_1 = (
    "pau; b p m; k g ng; ae ax ah aa; f v; ch sh jh; ao y iy ih ay aw; ow oy; n d t l; "
    "ey eh el em en er; th dh; s z zh; r; w uw uh; hh"
)
"""As printed in the paper."""


@dataclass(frozen=True)
class Row:
    """An equation and its two results."""

    equation: str
    by: str
    """Description of the independent implementation."""
    ours: np.ndarray
    other: np.ndarray
    reason: str = ""
    """Reason of a difference."""

    @property
    def difference(self) -> float:
        """Return the largest difference divided by the largest entry."""
        size = max(float(np.abs(self.other).max()), np.finfo(float).tiny)
        return float(np.abs(np.asarray(self.ours) - self.other).max()) / size


def run() -> None:
    """Print the table; fail if a difference above the limit has no reason."""
    print("| equation | independent | ours | theirs | largest difference | |")
    print("|---|---|---|---|---|---|")
    faults = []
    for row in (*_d06(), *_s11(), *_w06()):
        value, other = _norm(row.ours), _norm(row.other)
        print(
            f"| {row.equation} | {row.by} | {value:.9g} | {other:.9g} | {row.difference:.1e} | "
            f"{row.reason} |",
            flush=True,
        )
        if row.difference > EXACT_SHARE and not row.reason:
            faults.append(row.equation)
    if faults:
        raise SystemExit(f"no reason is given for the difference of {', '.join(faults)}")


def _norm(values: np.ndarray) -> float:
    """Return the root mean square, for the table."""
    return float(np.sqrt((np.asarray(values, float) ** 2).mean()))


def _d06() -> Iterator[Row]:
    rng = np.random.default_rng(0)
    reference = 60 * rng.normal(size=(3, 3))
    turned = np.linalg.qr(rng.normal(size=(300, 3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))[:, None, None]
    frames = reference @ turned.transpose(0, 2, 1) + rng.normal(size=(300, 3, 3))
    printed, proper = _kabsch(frames, reference)
    ours = align_rigid(frames, reference).rotations
    yield Row("D06 eq. 1–2, det R = 1", "own SVD, frame by frame", ours, proper)
    mirrored = int((np.linalg.det(printed) < 0).sum())
    yield Row(
        "D06 eq. 2 as printed", "V Uᵀ", ours, printed,
        f"V Uᵀ mirrors {mirrored} of 300 frames of three noisy markers",
    )  # fmt: skip
    data = rng.normal(size=(400, 30)) * np.geomspace(20, 0.1, 30)
    vectors = np.linalg.eigh(np.cov(data.T))[1]
    own = (data - data.mean(axis=0)) @ vectors[:, ::-1][:, :4]
    reduced = project(fit_pca(data, dimensions=4), data)  # signs of components are free
    yield Row("D06 eq. 3, four components", "own eigh", np.abs(reduced), np.abs(own))
    centres, weights = rng.normal(size=(40, 4)), rng.random((40, 12))
    widths, points = centre_widths(centres), rng.normal(size=(60, 4))
    loop = np.array(
        [[np.exp(-((p - c) @ (p - c)) / (2 * s**2)) for c, s in zip(centres, widths, strict=True)]
         for p in points]
    )  # fmt: skip
    yield Row("D06 eq. 4", "double loop", gaussian_design(points, centres, widths), loop)
    H = gaussian_design(centres, centres, widths)
    direct = np.linalg.solve(H.T @ H + 0.3 * np.eye(40), H.T @ weights)
    network = fit_rbf_ridge(centres, weights, widths=widths, ridge=0.3)
    solved = predict_rbf_ridge(points, centres, widths, network.coefficients)
    yield Row("D06 eq. 5–6", "normal equations", solved, loop @ direct)
    found = reestimate_ridge(rotate(H, weights), start=1e-3, tolerance=1e-14)
    orr = np.array([_orr(H, column, start=1e-3) for column in weights.T])
    yield Row("D06 λ by re-estimation", "own iteration, dense", found, orr)
    curves = rng.normal(size=(200, 5)).cumsum(axis=0)
    banked = apply_filter_bank(curves, gains=(0.0, 0.5, 1.0))
    yield Row("D06 filter bank", "own pyramid", banked, _pyramid(curves, (0.0, 0.5, 1.0)))
    deltas, motion = rng.normal(size=(12, 30, 3)), 3 * rng.normal(size=(25, 30, 3))
    matrix, right = deltas.reshape(12, -1).T, motion.reshape(25, -1)
    least = np.array([np.linalg.lstsq(matrix, row)[0] for row in right])
    yield Row("D06 eq. 7", "lstsq, frame by frame", solve_least_squares(deltas, motion), least)
    bounded = np.array([lsq_linear(matrix, row, (0, 1), tol=1e-14).x for row in right])
    yield Row(
        "D06 eq. 7 within 0 to 1", "scipy lsq_linear",
        solve_weights(deltas, motion).weights, bounded,
    )  # fmt: skip
    printed_groups = [tuple(group.split()) for group in TABLE_1.split("; ")]
    same = [ours == theirs for ours, theirs in
            zip(VISEME_PHONES.values(), printed_groups, strict=True)]  # fmt: skip
    yield Row("D06 Table 1, groups", "as printed", np.array([sum(same)]), np.array([15]))


def _kabsch(frames: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return V Uᵀ of every frame, and the nearest rotation."""
    printed, proper = [], []
    for frame in frames:
        y, x = reference - reference.mean(axis=0), frame - frame.mean(axis=0)
        U, _, Vt = np.linalg.svd(y.T @ x)
        flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
        printed.append(Vt.T @ U.T)
        proper.append(Vt.T @ flip @ U.T)
    return np.array(printed), np.array(proper)


def _orr(design: np.ndarray, y: np.ndarray, *, start: float) -> float:
    """Re-estimate the ridge of one output, with dense inverses: Orr (1996), section 6.4."""
    H, count = design, len(y)
    ridge, last = start * float(np.linalg.norm(H, 2) ** 2), np.inf
    for _ in range(500):
        inverse = np.linalg.inv(H.T @ H + ridge * np.eye(H.shape[1]))
        w = inverse @ H.T @ y
        trace = count - np.trace(H @ inverse @ H.T)
        error = float(((y - H @ w) ** 2).sum())
        score = count * error / trace**2
        if abs(last - score) <= 1e-14 * score:
            break
        last = score
        ridge = error * np.trace(inverse - ridge * inverse @ inverse) / (w @ inverse @ w * trace)
    return float(ridge)


def _pyramid(curves: np.ndarray, gains: tuple[float, ...]) -> np.ndarray:
    """Return Bruderlin and Williams's bands by convolution with constant ends."""
    kernel, levels = np.array([1, 4, 6, 4, 1]) / 16, [curves]
    for band in range(len(gains)):
        spread = np.zeros(4 * 2**band + 1)
        spread[:: 2**band] = kernel
        padded = np.pad(levels[-1], ((2 * 2**band,) * 2, (0, 0)), mode="edge")
        levels.append(np.array([np.convolve(c, spread, "valid") for c in padded.T]).T)
    bands = [gain * (a - b) for gain, a, b in zip(gains, levels, levels[1:], strict=False)]
    return sum(bands) + levels[-1]


def _predict(model: KernelCCA, points: np.ndarray) -> np.ndarray:
    return predict_expansion(points, model.centres, model.width, model.operator, model.intercept)


def _s11() -> Iterator[Row]:
    rng = np.random.default_rng(1)
    S, T, points = rng.random((34, 20)), rng.random((34, 15)), rng.random((50, 20))
    soft = np.array([np.sort(np.linalg.norm(S - s, axis=1))[1] for s in S])
    design = np.sqrt(cdist(S, S) ** 2 + soft**2)
    by_hand = np.sqrt(cdist(points, S) ** 2 + soft**2) @ np.linalg.solve(design, T)
    fitted = fit_multiquadric(S, T)
    network = predict_multiquadric(points, S, fitted.softness, fitted.coefficients)
    yield Row("S11 eq. 3–4", "numpy, dense", network, by_hand)
    widths, kappa = (2.0, 1.7), 1e-3
    few: dict[str, Any] = {
        "source_width": widths[0],
        "target_width": widths[1],
        "kappa": kappa,
        "components": 8,
    }
    model = fit_kernel_cca(S, T, **few, lines="published")
    correlations, basis, reduced = _dense_kcca(S, T, widths, kappa, 8)
    yield Row(
        "S11 eq. 5, penalty κ", "dense generalised eigenproblem", model.correlations, correlations
    )
    across = np.linalg.lstsq(reduced[0], reduced[1])[0]
    back = np.linalg.lstsq(reduced[1], T - T.mean(axis=0))[0]
    there = _centred(_gauss(points, S, widths[0]), _gauss(S, S, widths[0])) @ basis
    dense = there @ across @ back + T.mean(axis=0)
    regression = _predict(model, points)
    yield Row("S11 eq. 6–8, as printed", "dense lines", regression, dense)
    penalised = fit_kernel_cca(S, T, **few)
    yield Row(
        "S11 eq. 6–8, default", "dense lines", _predict(penalised, points), dense,
        "lines penalised as eq. 5 is (`train-retarget --published`: as printed)",
    )  # fmt: skip
    share = rng.random((50, 1))
    yield Row(
        "S11 eq. 9, keyed α", "by hand", share * network + (1 - share) * regression,
        share * by_hand + (1 - share) * dense,
    )  # fmt: skip
    motion = 0.3 + 0.3 * np.sin(0.05 * rng.normal(size=(900, 33)).cumsum(axis=0))
    pair = motion[400:440] + 0.01 * rng.normal(size=(40, 33))
    sums = np.array([np.linalg.norm(motion[k : k + 40] - pair, axis=1).sum() for k in range(861)])
    delta = float(np.quantile(sums, 0.02))
    limit = delta / (40 * np.sqrt(33))
    starts = starts_within(motion, pair, threshold=limit)
    yield Row("S11 eq. 10, F_st", "brute force", starts.starts, np.flatnonzero(sums <= delta))
    yield Row(
        "S11 eq. 10, averages", "brute force", find_published(motion, pair, delta=delta).starts,
        _averages(np.flatnonzero(sums <= delta), 40),
    )  # fmt: skip
    keys = rng.random((60, 33))
    plain = warp_motion(motion, [Insertion(300, keys, np.ones(60))], blend=0, keep=1.0)
    yield Row("S11 eq. 11–12", "dense normal equations", plain, _warped(motion, keys, 300))
    eased = warp_motion(motion, [Insertion(300, keys, np.ones(60))], blend=12, keep=1.0)
    yield Row(
        "S11 eq. 12, default blend", "dense normal equations", eased, _warped(motion, keys, 300),
        "12 frames on each side are free (`warp --blend 0`: as printed)",
    )  # fmt: skip
    source, target = rng.normal(size=(20, 90, 3)), rng.normal(size=(15, 90, 3))
    both = Correspondence(source, target, np.ones(20), np.ones(15), np.arange(20))
    asked = rng.random((30, 20))
    matched = match_positions(both, asked)
    matrix = target.reshape(15, -1).T
    wanted = asked @ source.reshape(20, -1)
    ridge = RIDGE_SHARE * float((matrix**2).sum(axis=0).mean())
    rows = np.vstack([matrix, np.sqrt(ridge) * np.eye(15)])
    ridged = np.array([nnls(rows, np.concatenate([b, np.zeros(15)]))[0] for b in wanted])
    yield Row("S11 fig. 2, NNLS with a ridge", "scipy nnls", matched, ridged)
    yield Row(
        "S11 fig. 2, NNLS", "scipy nnls", matched, np.array([nnls(matrix, b)[0] for b in wanted]),
        "a ridge of a thousandth keeps dependent shapes apart",
    )  # fmt: skip


def _gauss(points: np.ndarray, centres: np.ndarray, width: float) -> np.ndarray:
    return np.exp(-(cdist(points, centres) ** 2) / (2 * width**2))


def _centred(kernel: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Centre rows of a kernel in the feature space of the centres."""
    left = kernel - kernel.mean(axis=1, keepdims=True)
    return left - (own - own.mean(axis=1, keepdims=True)).mean(axis=0)


def _dense_kcca(
    source: np.ndarray, target: np.ndarray, widths: tuple[float, float], kappa: float, kept: int
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Solve eq. 5 as one generalised eigenproblem; return correlations, H_s and both reductions."""
    count = len(source)
    A, B = (
        _centred(_gauss(x, x, width), _gauss(x, x, width))
        for x, width in zip((source, target), widths, strict=True)
    )
    zero = np.zeros((count, count))
    penalty = kappa * count
    rounding = 1e-13 * np.eye(count)
    left = np.block([[zero, A @ B], [B @ A, zero]])
    right = np.block(
        [[A @ A + penalty * A + rounding, zero], [zero, B @ B + penalty * B + rounding]]
    )
    values, vectors = eigh(left, right)
    order = np.argsort(-values)[:kept]
    h_s, h_t = vectors[:count, order], vectors[count:, order]
    return values[order], h_s, [A @ h_s, B @ h_t]


def _averages(starts: np.ndarray, length: int) -> np.ndarray:
    out, left = [], starts.tolist()
    while left:
        group = [each for each in left if each < left[0] + length]
        out.append(round(sum(group) / len(group)))
        left = left[len(group) :]
    return np.array(out)


def _warped(motion: np.ndarray, keys: np.ndarray, start: int) -> np.ndarray:
    """Solve eq. 12 densely, every frame constrained by its key or by itself."""
    count = len(motion)
    laplacian = np.eye(count, k=1)[:-1] - np.eye(count)[:-1]
    targets = motion.copy()
    targets[start : start + len(keys)] = keys
    normal = laplacian.T @ laplacian + np.eye(count)
    return cho_solve(cho_factor(normal), laplacian.T @ (laplacian @ motion) + targets)


def _w06() -> Iterator[Row]:
    mouth = make_mouth()
    measured = mouth.distances(metric="dijkstra")
    paths = _own_dijkstra(mouth, inside=True)
    found = measured.geodesic_to_points
    yield Row("W06 dijk, markers on faces", "scipy dijkstra, own graph", found, paths)
    yield Row(
        "W06 dijk(vᵢ, vⱼ)", "scipy dijkstra, own graph", found, _own_dijkstra(mouth, inside=False),
        "a marker is anywhere on a face, and reaches its corners in a straight line",
    )  # fmt: skip
    straight = cdist(mouth.points[mouth.chosen], mouth.points)
    blend = BLEND_PUBLISHED * paths + (1 - BLEND_PUBLISHED) * straight
    ours = measured.blended_to_points(BLEND_PUBLISHED)
    yield Row("W06 δ ← wδ + (1 − w)γ", "by hand", ours, blend)
    between, blend = measured.blended_between(BLEND_PUBLISHED), ours.astype(float)
    stiff = nearest_stiffness(between)
    inverse = fit_distance_multiquadric(between, stiff)
    by_hand = np.sqrt(blend.T**2 + stiff**2) @ np.linalg.inv(np.sqrt(between**2 + stiff**2))
    yield Row(
        "W06 multiquadric over δ",
        "numpy, dense",
        multiquadric_fields(inverse, stiff, blend),
        by_hand,
    )
    scale = 20.0
    printed = np.exp(-0.5 * (between / scale) ** 2)
    covariance = fit_covariance(between, length_scale=scale, shape="published")
    negative = int((np.linalg.eigvalsh(printed) < 0).sum())
    yield Row(
        "W06 eq. 7, 20 mm", "as printed", covariance.matrix(), printed,
        f"{negative} of {len(printed)} eigenvalues are negative; the nearest part that is positive "
        f"is kept ({covariance.clipped:.2%} of the norm)",
    )  # fmt: skip
    spectrum = small_spectrum(12)
    rng = np.random.default_rng(0)
    rows = draw_rows(spectrum, rng, 6)
    thetas = spectrum.prior.centre[:, None] + 0.5 * rng.normal(size=(4, 6))
    moments = direct_moments(spectrum, rows @ spectrum.vectors, thetas[0] - thetas[1])
    energy, _ = energy_of_moments(
        thetas, moments, count=12, centre=spectrum.prior.centre[:, None],
        precision=np.array(spectrum.prior.spread)[:, None] ** -2.0,
    )  # fmt: skip
    dense = [dense_energy(spectrum, theta, row) for theta, row in zip(thetas.T, rows, strict=True)]
    yield Row("W06 eq. 8 and prior", "dense determinant and solve", energy, np.array(dense))
    theta = np.broadcast_to(thetas, (1, 4, 6))
    duals = average_dual_weights(spectrum, rows, theta).mean
    K, trend = dense_parts(spectrum)
    process = [
        (np.exp(t[0]) * K + (trend * np.exp(t[[2, 3, 3, 3]])) @ trend.T)
        @ np.linalg.solve(dense_covariance(spectrum, t), row)
        for t, row in zip(thetas.T, rows, strict=True)
    ]
    kernel = np.concatenate([K @ spectrum.vectors, trend], axis=1)
    yield Row("W06 prediction at θ", "textbook formula", duals @ kernel.T, np.array(process),
              "averaged in single precision")  # fmt: skip
    yield _sampled(spectrum, rows[:2], rng)


def _own_dijkstra(mouth: Mouth, *, inside: bool) -> np.ndarray:
    """Return shortest paths over edges: (markers, points).

    Parameters
    ----------
    inside : bool
        Whether paths start across the polygon of a marker, or along its edges.
    """
    points, markers = mouth.points, len(mouth.chosen)
    graph = np.full((len(points) + markers,) * 2, np.inf)
    faces = mouth.indices.reshape(len(mouth.counts), -1)
    for face in faces:
        for one, other in zip(face, np.roll(face, -1), strict=True):
            graph[one, other] = graph[other, one] = np.linalg.norm(points[one] - points[other])
    for row, (face, start) in enumerate(zip(mouth.places.faces, mouth.chosen, strict=True)):
        for corner in faces[face] if inside else [start]:
            length = np.linalg.norm(points[corner] - points[start])
            graph[len(points) + row, corner] = max(length, 1e-7)  # SciPy reads 0 as no edge
    return dijkstra(graph, indices=len(points) + np.arange(markers))[:, : len(points)]


def _sampled(spectrum, rows: np.ndarray, rng: np.random.Generator) -> Row:  # type: ignore[no-untyped-def]
    """Compare posterior means of the hyper-parameters with a random walk over the dense density."""
    many = np.repeat(rows, 100, axis=0)
    theta = sample_hyperparameters(rng, SharedTable(spectrum), many)[0]
    ours = theta.reshape(-1, 4, len(rows), 100).mean(axis=(0, 3)).T
    walked = []
    for row in rows:
        state = spectrum.prior.centre.copy()
        energy, total = dense_energy(spectrum, state, row), np.zeros(4)
        for step in range(42_000):
            proposal = state + 0.8 * rng.normal(size=4)
            other = dense_energy(spectrum, proposal, row)
            if rng.random() < np.exp(min(0.0, energy - other)):
                state, energy = proposal, other
            if step >= 2000:
                total += state
        walked.append(total / 40_000)
    return Row("W06 eq. 3, mean θ by HMC", "Metropolis, dense", ours, np.array(walked),
               "chance: 40,000 correlated steps against 20,000 samples")  # fmt: skip
