"""The published hybrid: multiquadric and kernel CCA blended; eq. 9 of Song et al. (2011).

Song, Choi, Seol and Noh, *Characteristic Facial Retargeting*, section 4.3. In the paper an artist
keys the blend weight alpha of the multiquadric over time. Here it is constant, a candidate setting.
"""

import numpy as np

from usdface.core.arrays import Arrays, FloatArray
from usdface.model.regressions.base import Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.kernel_cca import (
    RETARGET_KERNELS,
    fit_expansion,
    mapping_spaces,
    prepare_expansion,
)
from usdface.model.regressions.multiquadric import fit_network, prepare_network

_ALPHAS = (0.5, 0.25, 0.75)
"""Candidates of alpha; the first for too few pairs to compare."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "published", "kappa": 1e-4, "components": components, "alpha": alpha}
        for space in mapping_spaces(pairs, dimensions)
        for components in (15, 30)
        for alpha in _ALPHAS
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    arrays = fit_network(pairs, settings).arrays | fit_expansion(pairs, settings).arrays
    return Fitted(arrays, settings)


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    alpha = np.array([float(settings["alpha"])])
    return lambda inputs: predict_blended(arrays, settings, inputs, alpha)


def predict_blended(
    arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray
) -> FloatArray:
    """Return ``alpha multiquadric + (1 - alpha) kernel CCA``; alpha is (1,) or (frames,)."""
    network = prepare_network(arrays, settings)(inputs)
    regression = prepare_expansion(arrays, settings)(inputs)
    blended: FloatArray = alpha[:, None] * network + (1 - alpha[:, None]) * regression
    return blended


METHOD = Regression(
    name="hybrid",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
    retarget_candidates=tuple(
        kernel | {"alpha": alpha} for kernel in RETARGET_KERNELS for alpha in _ALPHAS
    ),
)
