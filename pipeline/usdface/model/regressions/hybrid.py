"""The published hybrid: multiquadric and kernel CCA blended; eq. 9 of Song et al. (2011).

Song, Choi, Seol and Noh, *Characteristic Facial Retargeting*, section 4.3. There a person keys the
share of the multiquadric over a sequence. A mapping's is one number, chosen on pairs that neither
part has seen; a retargeting's is one of its candidates.
"""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.regressions.base import Arrays, Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.kernel_cca import (
    RETARGET_KERNELS,
    fit_expansion,
    mapping_spaces,
    prepare_expansion,
)
from usdface.model.regressions.multiquadric import fit_network, prepare_network
from usdface.numerics.regression.cross_validation import Fold, predict_out_of_fold

_FOLD_COUNT = 5
_FEWEST_PAIRS = 8
"""Below these, cross-validation is chance: both parts then have the share 0.5."""

_ALPHAS = (0.25, 0.5, 0.75)
"""Shares of the multiquadric that retargeting tries."""


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
    """Blend both parts by one share of the multiquadric (1,), or by one for each frame (f,)."""
    network = prepare_network(arrays, settings)(inputs)
    regression = prepare_expansion(arrays, settings)(inputs)
    blended: FloatArray = alpha[:, None] * network + (1 - alpha[:, None]) * regression
    return blended


def _choose_alpha(pairs: Pairs, settings: Settings) -> float:
    """Return the share of the multiquadric that moves the surface least away from unseen pairs."""
    count = len(pairs.outputs)
    if count < _FEWEST_PAIRS:
        return 0.5
    turn = np.arange(count) % _FOLD_COUNT  # the pairs' times are not known: deal them in turn
    folds = [Fold(np.flatnonzero(turn != k), np.flatnonzero(turn == k)) for k in range(_FOLD_COUNT)]

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
    # |regression + alpha * difference|^2 in the metric of the surface is a parabola in alpha.
    gram = pairs.face.gram
    slope = -float(np.einsum("ns,st,nt->", regression, gram, difference))
    curvature = float(np.einsum("ns,st,nt->", difference, gram, difference))
    return float(np.clip(slope / curvature, 0.0, 1.0)) if curvature > 0 else 0.5


METHOD = Regression(
    name="hybrid",
    summary="multiquadric and kernel CCA blended by one share, chosen by cross-validation",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
    retarget_candidates=tuple(
        kernel | {"alpha": alpha} for kernel in RETARGET_KERNELS for alpha in _ALPHAS
    ),
)
