import numpy as np
import pytest
from sklearn import decomposition

from usdface.numerics.regression.pca import (
    fit_pca,
    pca_from_moments,
    project,
    sum_moments,
)


def correlated(rows: int, columns: int, *, offset: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(columns, columns)) * 0.7 ** np.arange(columns)
    return rng.normal(size=(rows, columns)) @ mixing.T + offset


@pytest.mark.parametrize(("rows", "columns"), [(300, 12), (9, 30)], ids=["tall", "wide"])
def test_components_and_coordinates_agree_with_sklearn(rows: int, columns: int) -> None:
    data = correlated(rows, columns, offset=50.0)
    ours = fit_pca(data, dimensions=6)
    theirs = decomposition.PCA(6).fit(data)
    signs = np.sign((ours.components * theirs.components_).sum(axis=1))
    np.testing.assert_allclose(
        ours.components, theirs.components_ * signs[:, None], rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(ours.variances, theirs.explained_variance_, rtol=1e-9)
    np.testing.assert_allclose(
        ours.variances / ours.total_variance, theirs.explained_variance_ratio_, rtol=1e-9
    )
    np.testing.assert_allclose(project(ours, data), theirs.transform(data) * signs, atol=1e-9)


def test_keeping_every_direction_reconstructs_the_data() -> None:
    data = correlated(40, 7, offset=-3.0)
    pca = fit_pca(data)
    rows = project(pca, data) @ pca.components + pca.mean
    np.testing.assert_allclose(rows, data, atol=1e-11)


def test_moments_of_float32_blocks_equal_those_of_the_whole_far_from_the_origin() -> None:
    data = correlated(20000, 6, offset=1e4).astype(np.float32)
    moments = sum_moments([data[:123], data[123:9000], data[9000:]])
    whole = data.astype(np.float64)
    assert moments.count == len(data)
    np.testing.assert_allclose(moments.mean, whole.mean(axis=0), rtol=1e-12)
    scatter = np.cov(whole.T) * (len(data) - 1)
    np.testing.assert_allclose(moments.scatter, scatter, atol=1e-8 * np.abs(scatter).max())


def test_signs_do_not_depend_on_the_order_of_rows() -> None:
    data = correlated(50, 5)
    first = fit_pca(data).components
    np.testing.assert_allclose(first, fit_pca(data[::-1]).components, atol=1e-10)


def test_bad_rows_and_options_are_named() -> None:
    data = correlated(20, 4)
    data[7, 2] = np.nan
    with pytest.raises(ValueError, match="row 7 holds a value that is not finite"):
        fit_pca(data)
    with pytest.raises(ValueError, match="at least 2 rows"):
        fit_pca(np.zeros((1, 4)))
    with pytest.raises(ValueError, match="dimensions must be from 1 to 4"):
        fit_pca(correlated(20, 4), dimensions=5)
    with pytest.raises(ValueError, match="no rows"):
        sum_moments([])
    with pytest.raises(ValueError, match="blocks of 4 and of 3 columns"):
        sum_moments([np.zeros((2, 4)), np.zeros((2, 3))])
    with pytest.raises(ValueError, match="at least 2 rows"):
        pca_from_moments(sum_moments([np.zeros((1, 3))]))
