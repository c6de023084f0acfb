"""Linear map through rest, plus a multiquadric for its residual.

BlendShapes are additive, which radial basis functions alone do not reproduce between and beyond the
pairs. The linear part is additive, the multiquadric represents the nonlinear remainder.
"""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import Arrays
from usdface.model.regressions.base import Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.multiquadric import fit_network, prepare_network

_SHRINKS = (1e-8, 1e-4, 1e-2)
"""Candidate ridges of the linear part, relative to the inputs' largest squared singular value."""


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    inputs, outputs = pairs.inputs, pairs.outputs
    ridge = float(settings["shrink"]) * float(np.linalg.norm(inputs, ord=2)) ** 2
    normal = inputs.T @ inputs + ridge * np.eye(inputs.shape[1])
    slope = np.asarray(np.linalg.solve(normal, inputs.T @ outputs), np.float64)
    network = fit_network(replace(pairs, outputs=outputs - inputs @ slope), settings)
    return Fitted({"slope": slope} | network.arrays, settings)


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    slope, network = arrays["slope"], prepare_network(arrays, settings)
    return lambda inputs: inputs @ slope + network(inputs)


METHOD = Regression(
    name="additive",
    fit=_fit,
    prepare=_prepare,
    retarget_candidates=tuple({"shrink": shrink} for shrink in _SHRINKS),
)
