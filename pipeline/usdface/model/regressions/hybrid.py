"""The published hybrid: multiquadric and kernel CCA blended; eq. 9 of Song et al. (2011).

Song, Choi, Seol and Noh, *Characteristic Facial Retargeting*, section 4.3. There a person keys the
blend over a retargeted sequence. A mapping has one, chosen on pairs that neither part has seen.
"""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.regressions import kernel_cca, multiquadric
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings
from usdface.model.regressions.scaling import coordinate_scale, scaled
from usdface.numerics.regression.cross_validation import Fold, predict_out_of_fold
from usdface.numerics.regression.multiquadric_rbf import predict_multiquadric

_FOLDS = 5
_FEWEST_PAIRS = 8
"""Fewer say nothing of pairs unseen: the parts then count alike."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "published", "kappa": 1e-4, "components": components}
        for space in kernel_cca.spaces(pairs, dimensions)
        for components in (15, 30)
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    scale = coordinate_scale(pairs, settings)
    network, _ = multiquadric.fit_pairs(pairs, scale, smooth=False)
    regression = kernel_cca.fit_pairs(pairs, scale, settings)
    arrays = multiquadric.multiquadric_arrays(network) | kernel_cca.kernel_cca_arrays(regression)
    alpha = _choose_alpha(pairs, scale, settings)
    return Fitted(arrays | {"scale": scale}, settings | {"alpha": alpha})


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    features = scaled(coordinates, arrays["scale"])
    alpha = float(settings["alpha"])
    network = predict_multiquadric(multiquadric.multiquadric_from_arrays(arrays), features)
    return alpha * network + (1 - alpha) * kernel_cca.predict_from_arrays(arrays, features)


def _choose_alpha(pairs: Pairs, scale: FloatArray, settings: Settings) -> float:
    """Return the share of the multiquadric that moves the surface least away from unseen pairs."""
    count = len(pairs.weights)
    if count < _FEWEST_PAIRS:
        return 0.5
    turn = np.arange(count) % _FOLDS  # the pairs' times are not known here: deal them in turn
    folds = [Fold(np.flatnonzero(turn != k), np.flatnonzero(turn == k)) for k in range(_FOLDS)]

    def by_network(train: IntArray, test: IntArray) -> FloatArray:
        model, _ = multiquadric.fit_pairs(pairs.rows(train), scale, smooth=False)
        return predict_multiquadric(model, scaled(pairs.coordinates[test], scale))

    def by_regression(train: IntArray, test: IntArray) -> FloatArray:
        model = kernel_cca.fit_pairs(pairs.rows(train), scale, settings)
        features = scaled(pairs.coordinates[test], scale)
        return kernel_cca.predict_from_arrays(kernel_cca.kernel_cca_arrays(model), features)

    width = pairs.weights.shape[1]
    network = predict_out_of_fold(by_network, folds, width=width) - pairs.weights
    regression = predict_out_of_fold(by_regression, folds, width=width) - pairs.weights
    apart = network - regression
    # |regression + alpha * apart|^2 in the metric of the surface is a parabola in alpha.
    toward = -float(np.einsum("ns,st,nt->", regression, pairs.gram, apart))
    curvature = float(np.einsum("ns,st,nt->", apart, pairs.gram, apart))
    return float(np.clip(toward / curvature, 0.0, 1.0)) if curvature > 0 else 0.5


METHOD = Method(
    name="hybrid",
    summary="multiquadric and kernel CCA blended by one share, chosen by cross-validation",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
