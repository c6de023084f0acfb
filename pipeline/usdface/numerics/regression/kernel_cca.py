"""Regression through regularised kernel canonical correlation: Song et al. (2011), eq. 5-8.

Source and target expressions are mapped to the feature spaces of Gaussian kernels and reduced to
their canonical directions; linear maps follow from the reduced source to the reduced target (eq. 6)
and from that to the target (eq. 7).

Without a penalty all correlations of kernel features are 1, whatever the data. So the functions are
penalised by their norm: ``h' A^2 h`` of eq. 5 becomes ``h' (A^2 + kappa n A) h``, with A the
centred kernel matrix of n pairs.

The linear maps are printed without a penalty. With all directions they interpolate the pairs,
whatever kappa is. So either the directions are few, as published, or the maps have the penalty of
eq. 5 too. Then they are in closed form: the first is the diagonal matrix of the correlations, the
second the target projected on its directions.

References
----------
Hardoon, Szedmak and Shawe-Taylor (2004), *Canonical correlation analysis: an overview with
application to learning methods*, Neural Computation 16(12), section 3.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray
from usdface.numerics.regression.linear_ridge import check_examples
from usdface.numerics.regression.rbf_ridge import evaluate_network, gaussian_design

Lines = Literal["published", "penalised"]

_NULL_SHARE = 1e-12
"""[of the largest eigenvalue of a kernel matrix] Smaller ones are rounding."""

_LEAST_CORRELATION = 1e-6
"""Of canonical directions that are used."""


@dataclass(frozen=True)
class KernelCCA:
    """Fitted: ``F(x) = sum_j operator[j] exp(-|x - centres[j]|^2 / 2 width^2) + b``."""

    centres: FloatArray
    """(n, d): sources of the pairs."""
    width: float
    """Of the source's kernel."""
    correlations: FloatArray
    """(k,): between the reduced source and target, penalised; descending, in (0, 1)."""
    operator: FloatArray
    """(n, s): the paper's M_kCCA: the product of H_s, M_s (eq. 6) and M_t (eq. 7)."""
    intercept: FloatArray
    """(s,): from the centring of kernel and target."""


def median_width(points: FloatArray, *, multiple: float = 1.0) -> float:
    """Return a multiple of the median distance between points."""
    from scipy.spatial.distance import pdist  # imported late: it takes half a second

    distances = pdist(points)
    middle = float(np.median(distances)) if len(distances) else 0.0
    if middle == 0.0:
        middle = float(distances.mean()) if len(distances) else 0.0  # most points repeat one
    if middle == 0.0:
        raise ValueError(f"all {len(points)} points coincide; no width fits them")
    return multiple * middle


def fit_kernel_cca(
    sources: ArrayLike,
    targets: ArrayLike,
    *,
    source_width: float,
    target_width: float,
    kappa: float,
    components: int | None = None,
    lines: Lines = "penalised",
) -> KernelCCA:
    """Fit the regression to pairs.

    Equation 7 is printed with the reduced *source* on its right; solved here is the least-squares
    map from the reduced target to the target.

    Parameters
    ----------
    sources : (n, d) array
    targets : (n, s) array
    source_width, target_width : float
        Standard deviations of the Gaussian kernels; see `median_width`.
    kappa : float
        Penalty per pair, positive: without one everything correlates. Larger is smoother.
    components : int, optional
        Number of directions; by default all that correlate.
    lines : {'penalised', 'published'}
        Whether eq. 6 and 7 have the penalty of eq. 5, or are plain least squares.
    """
    S, T = np.asarray(sources, np.float64), np.asarray(targets, np.float64)
    check_examples(S, T)
    penalty = kappa * len(S)
    kernel = _kernel(S, S, source_width)
    values_a, vectors_a = _centred_spectrum(kernel)
    values_b, vectors_b = _centred_spectrum(_kernel(T, T, target_width))
    # In the kernels' eigenvectors, scaled so that both constraints of eq. 5 are unit balls, eq. 5
    # is a singular value problem.
    shrunk_a = np.sqrt(values_a / (values_a + penalty))
    shrunk_b = np.sqrt(values_b / (values_b + penalty))
    left, correlations, right = np.linalg.svd(
        shrunk_a[:, None] * (vectors_a.T @ vectors_b) * shrunk_b, full_matrices=False
    )
    count = max(1, int((correlations > _LEAST_CORRELATION).sum()))
    count = count if components is None else min(count, components)
    left, correlations, right = left[:, :count], correlations[:count], right[:count].T
    basis = vectors_a @ (left / np.sqrt(values_a * (values_a + penalty))[:, None])
    reduced_source = vectors_a @ (shrunk_a[:, None] * left)
    reduced_target = vectors_b @ (shrunk_b[:, None] * right)
    mean = T.mean(axis=0)
    if lines == "published":
        across = np.linalg.lstsq(reduced_source, reduced_target)[0]
        back = np.linalg.lstsq(reduced_target, T - mean)[0]
    else:  # the constraints of eq. 5 make the normal matrices of the penalised maps unit matrices
        across = np.diag(correlations)
        back = reduced_target.T @ (T - mean)
    operator = basis @ across @ back
    return KernelCCA(
        centres=S,
        width=float(source_width),
        correlations=correlations,
        operator=operator,
        # The basis is orthogonal to constants, so the kernel's centring only contributes here.
        intercept=mean - kernel.mean(axis=0) @ operator,
    )


def predict_expansion(
    points: FloatArray,
    centres: FloatArray,
    width: float,
    operator: FloatArray,
    intercept: FloatArray,
) -> FloatArray:
    """Evaluate the kernel expansion of a `KernelCCA` in blocks, from what a mapping stores."""
    out = evaluate_network(lambda some: _kernel(some, centres, width), operator, points)
    out += intercept
    return out


def _kernel(points: FloatArray, centres: FloatArray, width: float) -> FloatArray:
    return gaussian_design(points, centres, np.full(len(centres), width))


def _centred_spectrum(kernel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues and eigenvectors of a centred kernel matrix, without its null space."""
    centred = kernel - kernel.mean(axis=0)
    centred -= centred.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh((centred + centred.T) / 2)
    real = values > _NULL_SHARE * max(float(values[-1]), np.finfo(float).tiny)
    return values[real], vectors[:, real]
