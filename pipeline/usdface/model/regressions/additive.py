"""Linear map through rest, plus a multiquadric for its residual.

BlendShapes are additive, which radial basis functions alone do not reproduce between and beyond the
pairs. The linear part is additive, with a ridge by its evidence, as similar pairs that are inexact
have slopes of any size. The multiquadric represents the nonlinear remainder.
"""

from dataclasses import replace

from usdface.core.arrays import Arrays
from usdface.model.regressions.base import Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.multiquadric import fit_network, prepare_network
from usdface.numerics.regression.linear_ridge import fit_slope


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    slope = fit_slope(pairs.inputs, pairs.outputs)
    residual = replace(pairs, outputs=pairs.outputs - pairs.inputs @ slope)
    return Fitted({"slope": slope} | fit_network(residual, settings).arrays, settings)


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    slope, network = arrays["slope"], prepare_network(arrays, settings)
    return lambda inputs: inputs @ slope + network(inputs)


METHOD = Regression(name="additive", fit=_fit, prepare=_prepare, retarget_candidates=({},))
