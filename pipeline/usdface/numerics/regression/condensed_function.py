"""A function that is dear to evaluate, condensed: fitted on many points to few shared kernels.

What hundreds of local kernels for every output come to is smooth where faces go, and few kernels
that all outputs share come to the same there. Outputs that turn out too rough for it stay as they
are. Two such fits from different centres answer together; where they disagree they know too
little, and the function itself is asked: what comes out is right everywhere, and cheap where most
points are.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of
from usdface.numerics.regression.local_sums import SINGLE_NORM

CENTRES = 200
"""Kernels of each of the two fits."""

FEWEST_POINTS = 400
"""Sample points below which there is nothing to condense from."""

ROUGH = 0.005
"""Error, at any of the points left out of the fit, from which an output is left as it is."""

AGREED = 0.004
"""Difference of the two fits, in any output, up to which their mean is taken."""

WORTH_IT = 0.5
"""Share of the outputs that must not be rough, or nothing is gained."""

_WHITENING = 0.25  # power of the variance by which components are brought to like sizes
_WIDTH = 4.0  # of the kernels, in the median squared distance of points
_RIDGE = 1e-7
_LEFT_OUT = 5  # every fifth point is for judging
_SEED = 0


def condense(
    function: Callable[[FloatArray], FloatArray], sample: FloatArray, *, noise: float
) -> dict[str, FloatArray] | None:
    """Fit few shared kernels to a function.

    Parameters
    ----------
    function : callable
        (f, D) float array to (f, s) float array; of the order of 1.
    sample : (n, D) float array
        Points like those it will be asked for.
    noise : float
        Standard deviation by which points may lie beside the sample in any direction.

    Returns
    -------
    dict of str to float array, or None
        ``scale`` (D,), ``centres`` (2, m, D), ``exponent`` (1,), ``dual`` (2, m, s) and ``line``
        (2, D + 1, s), as `CondensedFunction` reads them, and ``smooth`` (s,), 1 for the outputs
        that were condensed; the others come out as 0. None where points are too few, or most
        outputs too rough.
    """
    judged = np.arange(len(sample)) % _LEFT_OUT == 0
    taught = sample[~judged]
    if len(taught) < FEWEST_POINTS:
        return None
    random = np.random.default_rng(_SEED)
    count = min(CENTRES, len(taught) // 4)
    beside = taught + noise * random.normal(size=taught.shape)
    points = np.concatenate([taught, beside])
    scale = np.maximum(taught.var(axis=0), 1e-12) ** -_WHITENING
    chosen = random.permutation(len(taught))[: 2 * count].reshape(2, count)
    centres = (taught * scale)[chosen]
    apart = float(np.median(((centres[0] - centres[1]) ** 2).sum(axis=1)))
    if apart == 0.0:  # a face that does not move
        return None
    exponent = np.array([-1 / (_WIDTH * apart)])
    values = function(points)
    fits = [_fit(points, values, scale, half, float(exponent[0])) for half in centres]
    arrays = {
        "scale": scale,
        "centres": centres,
        "exponent": exponent,
        "dual": np.stack([fit[:count] for fit in fits]),
        "line": np.stack([fit[count:] for fit in fits]),
    }
    mean, _ = CondensedFunction(arrays).both(sample[judged])
    smooth = np.abs(mean - function(sample[judged])).max(axis=0) < ROUGH
    if smooth.mean() < WORTH_IT:
        return None
    arrays["dual"] *= smooth
    arrays["line"] *= smooth
    return arrays | {"smooth": smooth.astype(np.float64)}


def _fit(
    points: FloatArray, values: FloatArray, scale: FloatArray, centres: FloatArray, exponent: float
) -> FloatArray:
    """Least squares, lightly damped: of kernels around the centres, and a line."""
    rows = points * scale
    squares = np.einsum("nd,nd->n", rows, rows)[:, None] - 2 * rows @ centres.T
    squares += np.einsum("md,md->m", centres, centres)
    design = np.concatenate([np.exp(exponent * squares), rows, np.ones((len(rows), 1))], axis=1)
    normal = design.T @ design + _RIDGE * np.eye(design.shape[1])
    found: FloatArray = np.linalg.solve(normal, design.T @ values)
    return found


class CondensedFunction:
    """Evaluates what `condense` found, and says where it can be believed.

    Parameters
    ----------
    arrays : dict of str to float array
        From `condense`.
    single : bool
        Evaluate in single precision where the duals allow it, as `LocalSums` does.
    device : ArrayDevice
        Where points will be.
    """

    def __init__(
        self, arrays: dict[str, FloatArray], *, single: bool = False, device: ArrayDevice = CPU
    ) -> None:
        scale, centres, exponent = (arrays[name] for name in ("scale", "centres", "exponent"))
        flat = centres.reshape(-1, len(scale))
        squares = np.einsum("md,md->m", flat, flat)
        kernels = exponent[0] * np.vstack([-2 * flat.T, np.ones(len(flat)), squares])
        line = np.concatenate(list(arrays["line"]), axis=1)
        lines = np.vstack([line[:-1], np.zeros(line.shape[1]), line[-1]])
        self._count, self._outputs = centres.shape[1], arrays["dual"].shape[2]
        rounded = single and np.linalg.norm(arrays["dual"], axis=1).max() <= SINGLE_NORM
        kind = "float32" if rounded else "float64"
        self._scale = device.put(scale)
        # of features, the squared norm of the row and 1: exponents of kernels, then both lines
        self._operand = device.put(np.ascontiguousarray(np.hstack([kernels, lines])), dtype=kind)
        self._duals = [
            device.put(np.ascontiguousarray(dual), dtype=kind) for dual in arrays["dual"]
        ]

    def both(self, points: Any) -> tuple[Any, Any]:
        """Evaluate both fits.

        Parameters
        ----------
        points : (f, D) float array

        Returns
        -------
        mean : (f, s) float array
            Of the two.
        agree : (f,) bool array
            Whether they differ by no more than `AGREED` in any output.
        """
        xp = namespace_of(points)
        rows = xp.astype(points * self._scale, self._operand.dtype)
        squares = xp.sum(rows * rows, axis=1, keepdims=True)
        found = xp.matmul(xp.concat([rows, squares, xp.ones_like(squares)], axis=1), self._operand)
        lines = 2 * self._count
        one, other = (
            xp.matmul(xp.exp(found[:, k * self._count : (k + 1) * self._count]), dual)
            + found[:, lines + k * self._outputs : lines + (k + 1) * self._outputs]
            for k, dual in enumerate(self._duals)
        )
        agree = xp.max(xp.abs(one - other), axis=1) <= AGREED
        return xp.astype((one + other) / 2, points.dtype), agree

    def __call__(self, points: Any, function: Callable[[Any], Any]) -> Any:
        """Evaluate; ask the function itself where the two fits disagree.

        Parameters
        ----------
        points : (f, D) float array
        function : callable
            What was condensed.

        Returns
        -------
        (f, s) float array
        """
        xp = namespace_of(points)
        mean, agree = self.both(points)
        if xp.all(agree):
            return mean
        order = xp.argsort(xp.astype(agree, xp.int64), stable=True)  # those that disagree first
        asked = order[: int(xp.sum(xp.astype(~agree, xp.int64)))]
        found = function(xp.take(points, asked, axis=0))
        rest = xp.take(mean, order[asked.shape[0] :], axis=0)
        back = xp.argsort(order, stable=True)
        return xp.take(xp.concat([found, rest], axis=0), back, axis=0)
