"""The published hybrid: multiquadric and kernel CCA blended; eq. 9 of Song et al. (2011).

Song, Choi, Seol and Noh, *Characteristic Facial Retargeting*, section 4.3. In the paper an artist
keys the blend weight alpha of the multiquadric over time. In a mapping it is constant and chosen by
cross-validation; in a retargeting it is a candidate setting.
"""

import numpy as np

from usdface.core.arrays import Arrays, FloatArray, IntArray
from usdface.model.regressions.base import Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.kernel_cca import (
    RETARGET_KERNELS,
    fit_expansion,
    mapping_spaces,
    prepare_expansion,
)
from usdface.model.regressions.multiquadric import fit_network, prepare_network
from usdface.numerics.regression.cross_validation import Fold, predict_out_of_fold

_FOLD_COUNT = 5
_MIN_PAIRS = 8
"""Fewer pairs are too few for cross-validation; alpha is then .5."""

_ALPHAS = (0.25, 0.5, 0.75)
"""Candidates of alpha in retargeting."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "published", "kappa": 1e-4, "components": components}
        for space in mapping_spaces(pairs, dimensions)
        for components in (15, 30)
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    arrays = fit_network(pairs, settings).arrays | fit_expansion(pairs, settings).arrays
    alpha = settings["alpha"] if "alpha" in settings else _choose_alpha(pairs, settings)
    return Fitted(arrays, settings | {"alpha": alpha})


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


def _choose_alpha(pairs: Pairs, settings: Settings) -> float:
    """Return the alpha of least surface error in cross-validation."""
    count = len(pairs.outputs)
    if count < _MIN_PAIRS:
        return 0.5
    label = np.arange(count) % _FOLD_COUNT  # interleaved, as the pairs' times are unknown
    folds = [
        Fold(np.flatnonzero(label != k), np.flatnonzero(label == k)) for k in range(_FOLD_COUNT)
    ]

    def by_network(train: IntArray, test: IntArray) -> FloatArray:
        fitted = fit_network(pairs.rows(train), settings)
        return prepare_network(fitted.arrays, settings)(pairs.inputs[test])

    def by_regression(train: IntArray, test: IntArray) -> FloatArray:
        fitted = fit_expansion(pairs.rows(train), settings)
        return prepare_expansion(fitted.arrays, settings)(pairs.inputs[test])

    width = pairs.outputs.shape[1]
    network = predict_out_of_fold(by_network, folds, width=width) - pairs.outputs
    regression = predict_out_of_fold(by_regression, folds, width=width) - pairs.outputs
    difference = network - regression
    # Minimum of |regression + alpha difference|^2, a parabola in alpha, in the surface's metric.
    gram = pairs.face.gram
    slope = -float(np.einsum("ns,st,nt->", regression, gram, difference))
    curvature = float(np.einsum("ns,st,nt->", difference, gram, difference))
    return float(np.clip(slope / curvature, 0.0, 1.0)) if curvature > 0 else 0.5


METHOD = Regression(
    name="hybrid",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
    retarget_candidates=tuple(
        kernel | {"alpha": alpha} for kernel in RETARGET_KERNELS for alpha in _ALPHAS
    ),
)
