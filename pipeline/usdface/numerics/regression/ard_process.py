"""Gaussian process whose relevances are learned: a length for each feature, by evidence.

``k(x, y) = amplitude exp(-sum_j (x_j - y_j)^2 / 2 lengths_j^2)`` and noise, shared by outputs of
unit variance. A feature that tells nothing gets a length beyond all distances: automatic relevance
determination.

References
----------
Rasmussen and Williams (2006), *Gaussian Processes for Machine Learning*, sections 2.2, 5.1, 5.4.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_STEPS = 100
_LOG_LENGTH = (-1.0, 6.0)  # around 1: features are scaled to unit deviation first
_LOG_AMPLITUDE = (-3.0, 6.0)
_LOG_NOISE = (-11.0, 1.0)


@dataclass(frozen=True)
class ARDProcess:
    """A fitted process: ``F(x) = mean + k(x, centres) @ dual``.

    Attributes
    ----------
    centres : (n, d) float array
    lengths : (d,) float array
        In the features' own units.
    amplitude, noise : float
        Variances, of outputs scaled to unit variance.
    dual : (n, s) float array
        The amplitude and the outputs' own scale included.
    mean : (s,) float array
    evidence : float
        Log marginal likelihood of the scaled outputs.
    """

    centres: FloatArray
    lengths: FloatArray
    amplitude: float
    noise: float
    dual: FloatArray
    mean: FloatArray
    evidence: float


def fit_ard_process(
    features: FloatArray, outputs: FloatArray, *, least_deviation: float = 0.0
) -> ARDProcess:
    """Fit lengths, amplitude and noise by maximum evidence, from one length for all.

    Parameters
    ----------
    features : (n, d) float array
    outputs : (n, s) float array
    least_deviation : float, optional
        What a feature is taken to deviate at least: smaller differences are not looked at as if
        they were large, because in use they are noise.

    Raises
    ------
    ValueError
        If there are fewer than two pairs, shapes differ or a value is not finite.
    """
    if features.ndim != 2 or outputs.ndim != 2 or len(features) != len(outputs):
        raise ValueError(f"{features.shape} features and {outputs.shape} outputs do not pair up")
    if len(features) < 2:
        raise ValueError(f"a process needs at least 2 pairs, got {len(features)}")
    if not (np.isfinite(features).all() and np.isfinite(outputs).all()):
        raise ValueError("features or outputs hold values that are not finite")
    count, dimensions = features.shape
    unit = np.maximum(features.std(axis=0), max(least_deviation, 1e-12))
    from scipy.linalg import cho_factor, cho_solve  # only when wanted: it takes half a second
    from scipy.optimize import minimize

    mean, scale = outputs.mean(axis=0), outputs.std(axis=0)
    told = scale > 1e-12
    rows, targets = features / unit, (outputs - mean)[:, told] / scale[told]
    start = np.concatenate([np.full(dimensions, 0.5 * np.log(dimensions) + 0.7), [1.0, -4.0]])

    def cost(theta: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = log_evidence(rows, targets, theta)
        return -value, -gradient

    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[_LOG_LENGTH] * dimensions + [_LOG_AMPLITUDE, _LOG_NOISE],
        options={"maxiter": _STEPS},
    )
    lengths, amplitude = np.exp(found.x[:dimensions]), float(np.exp(found.x[-2]))
    noise = float(np.exp(found.x[-1]))
    kernel = amplitude * _correlations(rows / lengths, rows / lengths)
    factor = cho_factor(kernel + noise * np.eye(count), lower=True)
    dual = np.zeros_like(outputs)
    dual[:, told] = amplitude * cho_solve(factor, targets) * scale[told]
    return ARDProcess(features, lengths * unit, amplitude, noise, dual, mean, -float(found.fun))


def log_evidence(
    features: FloatArray, outputs: FloatArray, theta: FloatArray
) -> tuple[float, FloatArray]:
    """Return the log marginal likelihood of all outputs and its gradient.

    Parameters
    ----------
    features : (n, d) float array
    outputs : (n, s) float array
    theta : (d + 2,) float array
        Logarithms of lengths, amplitude and noise variance.
    """
    from scipy.linalg import cho_factor, cho_solve  # only when wanted: it takes half a second

    count, columns = outputs.shape
    amplitude, noise = np.exp(theta[-2]), np.exp(theta[-1])
    rows = features / np.exp(theta[:-2])
    kernel = amplitude * _correlations(rows, rows)
    factor = cho_factor(kernel + noise * np.eye(count), lower=True)
    dual = cho_solve(factor, outputs)
    inside = columns * (float(np.log(np.diag(factor[0])).sum()) + 0.5 * count * np.log(2 * np.pi))
    value = -0.5 * float(np.einsum("ns,ns->", outputs, dual)) - inside
    # d value = tr((dual dual' - s K^-1) dK) / 2 [Rasmussen and Williams, eq. 5.9]
    pull = dual @ dual.T - columns * cho_solve(factor, np.eye(count))
    weighted = pull * kernel
    across = weighted.sum(axis=1) @ rows**2 - np.einsum("id,id->d", rows, weighted @ rows)
    gradient = np.concatenate([across, [0.5 * weighted.sum(), 0.5 * noise * np.trace(pull)]])
    return value, gradient


def predict_ard_process(model: ARDProcess, features: FloatArray) -> FloatArray:
    """Evaluate the process's mean: (f, d) features to (f, s) outputs."""
    near = _correlations(features / model.lengths, model.centres / model.lengths)
    out: FloatArray = near @ model.dual
    out += model.mean
    return out


def _correlations(left: FloatArray, right: FloatArray) -> FloatArray:
    out: FloatArray = left @ right.T
    out -= 0.5 * np.einsum("ij,ij->i", left, left)[:, None]
    out -= 0.5 * np.einsum("ij,ij->i", right, right)
    np.minimum(out, 0.0, out=out)
    np.exp(out, out=out)
    return out
