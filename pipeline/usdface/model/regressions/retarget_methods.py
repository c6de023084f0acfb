"""From source weights to coordinates of a control vector: the regressions of S11 and beside them.

S11 is Song, Choi, Seol and Noh (2011), *Characteristic Facial Retargeting*, section 4. Each method
is a fit of pairs (inputs, outputs) and a prediction from the arrays the fit left, so that a mapping
reopened from disk predicts the same to the last bit. Outputs are differences from rest.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.numerics.regression.kernel_cca import fit_kernel_cca, median_width, predict_expansion
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.multiquadric_rbf import (
    Multiquadric,
    fit_multiquadric,
    predict_multiquadric,
)

Settings = dict[str, float | int | str | bool]
Arrays = dict[str, FloatArray]

KERNEL_WIDTHS = (1.0, 2.0, 4.0, 8.0)
"""Multiples of the median distance between pairs that are tried."""

KAPPAS = (1e-6, 1e-4, 1e-2)
SHRINKS = (1e-8, 1e-4, 1e-2)
"""Ridges of the straight line beneath the network, as shares of its largest eigenvalue."""

ALPHAS = (0.25, 0.5, 0.75)
"""Shares of the multiquadric in the hybrid that are tried."""


@dataclass(frozen=True)
class RetargetMethod:
    """One way from source weights to a control vector.

    Attributes
    ----------
    name, summary : str
    candidates : tuple of dict
        Settings worth trying.
    fit : callable
        ``(inputs (n, d), outputs (n, k), settings) -> arrays``
    predict : callable
        ``(arrays, settings, inputs (f, d), alpha (f,) or None) -> outputs (f, k)``
    """

    name: str
    summary: str
    candidates: tuple[Settings, ...]
    fit: Callable[[FloatArray, FloatArray, Settings], Arrays]
    predict: Callable[[Arrays, Settings, FloatArray, FloatArray | None], FloatArray]


def find_retarget_method(name: str) -> RetargetMethod:
    """Look a method up by name.

    Raises
    ------
    InputError
        If there is none; the message lists those there are.
    """
    if name not in RETARGET_METHODS:
        known = ", ".join(("auto", *RETARGET_METHODS))
        raise InputError(f"no retargeting method {name!r}; choose one of {known}")
    return RETARGET_METHODS[name]


def _fit_ridge(inputs: FloatArray, outputs: FloatArray, settings: Settings) -> Arrays:
    line = fit_linear_ridge(inputs, outputs)
    return {"mean": line.mean, "slope": line.coefficients, "intercept": line.intercept}


def _predict_ridge(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    return (inputs - arrays["mean"]) @ arrays["slope"] + arrays["intercept"]


def _fit_rbf(inputs: FloatArray, outputs: FloatArray, settings: Settings) -> Arrays:
    """Fit eq. 3; where two pairs conflict, so that it cannot meet both, as near as it can."""
    try:
        network = fit_multiquadric(inputs, outputs)
    except ValueError:
        network = fit_multiquadric(inputs, outputs, smooth=True)
    return {
        "centres": network.centres,
        "softness": network.softness,
        "coefficients": network.coefficients,
    }


def _predict_rbf(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    width = arrays["coefficients"].shape[1]
    network = Multiquadric(
        arrays["centres"], arrays["softness"], arrays["coefficients"], np.zeros(width)
    )
    return predict_multiquadric(network, inputs)


def _fit_kernel_cca(inputs: FloatArray, outputs: FloatArray, settings: Settings) -> Arrays:
    wide = float(settings["width"])
    regression = fit_kernel_cca(
        inputs,
        outputs,
        source_width=median_width(inputs, multiple=wide),
        target_width=median_width(outputs, multiple=wide),
        kappa=float(settings["kappa"]),
    )
    return {
        "sources": regression.centres,
        "width": np.array([regression.width]),
        "operator": regression.operator,
        "offset": regression.intercept,
        "correlations": regression.correlations,
    }


def _predict_kernel_cca(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    return predict_expansion(
        inputs, arrays["sources"], float(arrays["width"][0]), arrays["operator"], arrays["offset"]
    )


def _fit_hybrid(inputs: FloatArray, outputs: FloatArray, settings: Settings) -> Arrays:
    return _fit_rbf(inputs, outputs, settings) | _fit_kernel_cca(inputs, outputs, settings)


def _predict_hybrid(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    """Blend both (eq. 9), by one share or by one for each frame."""
    share = np.full(len(inputs), float(settings["alpha"])) if alpha is None else alpha
    network = _predict_rbf(arrays, settings, inputs, None)
    regression = _predict_kernel_cca(arrays, settings, inputs, None)
    return share[:, None] * network + (1 - share[:, None]) * regression


def _fit_additive(inputs: FloatArray, outputs: FloatArray, settings: Settings) -> Arrays:
    """Fit a line through rest, and a multiquadric to what it leaves.

    Expressions of BlendShapes add up; a network of distances alone forgets that between the pairs
    and beyond them. The line carries the sums, the network what is bent.
    """
    singular = np.linalg.norm(inputs, ord=2)
    ridge = float(settings["shrink"]) * float(singular) ** 2
    normal = inputs.T @ inputs + ridge * np.eye(inputs.shape[1])
    slope = np.asarray(np.linalg.solve(normal, inputs.T @ outputs), np.float64)
    return {"slope": slope} | _fit_rbf(inputs, outputs - inputs @ slope, settings)


def _predict_additive(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    return inputs @ arrays["slope"] + _predict_rbf(arrays, settings, inputs, None)


_KERNELS: tuple[Settings, ...] = tuple(
    {"width": width, "kappa": kappa} for width in KERNEL_WIDTHS for kappa in KAPPAS
)

RETARGET_METHODS: dict[str, RetargetMethod] = {
    method.name: method
    for method in (
        RetargetMethod(
            "ridge", "a straight line, ridge by leave-one-out", ({},), _fit_ridge, _predict_ridge
        ),
        RetargetMethod("rbf", "Hardy multiquadric (S11, eq. 3-4)", ({},), _fit_rbf, _predict_rbf),
        RetargetMethod(
            "kernel_cca",
            "kernel canonical correlation (S11, eq. 5-8)",
            _KERNELS,
            _fit_kernel_cca,
            _predict_kernel_cca,
        ),
        RetargetMethod(
            "hybrid",
            "multiquadric and kernel CCA blended (S11, eq. 9)",
            tuple(kernel | {"alpha": alpha} for kernel in _KERNELS for alpha in ALPHAS),
            _fit_hybrid,
            _predict_hybrid,
        ),
        RetargetMethod(
            "additive",
            "a line that adds expressions up, a multiquadric for what it leaves",
            tuple({"shrink": shrink} for shrink in SHRINKS),
            _fit_additive,
            _predict_additive,
        ),
    )
}
