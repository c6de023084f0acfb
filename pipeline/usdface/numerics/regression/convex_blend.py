"""Several guesses of one thing, blended so that the error of the blend is least."""

from itertools import combinations

import numpy as np

from usdface.core.arrays import FloatArray

MOST_MEMBERS = 8
"""Every subset of the members is tried: beyond these, too many."""


def blend_shares(covariance: FloatArray) -> FloatArray:
    """Return the shares, none below 0, that minimise the variance of a blend.

    Where errors are independent these are inverse variances; members that err together share
    what one of them alone would have.

    Parameters
    ----------
    covariance : (outputs, members, members) float array
        Of the members' errors, for each output; positive definite.

    Returns
    -------
    (members, outputs) float array
        Each column sums to 1.

    Raises
    ------
    ValueError
        If the shape is another, or there are more than `MOST_MEMBERS` members.

    References
    ----------
    Bates and Granger (1969), Operational Research Quarterly 20(4), 451-468, for two members.
    """
    if covariance.ndim != 3 or covariance.shape[1] != covariance.shape[2]:
        raise ValueError(f"covariance must be (outputs, members, members), got {covariance.shape}")
    outputs, members, _ = covariance.shape
    if not 1 <= members <= MOST_MEMBERS:
        raise ValueError(f"1 to {MOST_MEMBERS} members can be blended, got {members}")
    least = np.full(outputs, np.inf)
    shares = np.zeros((members, outputs))
    for size in range(1, members + 1):
        for chosen in combinations(range(members), size):
            own = covariance[np.ix_(range(outputs), chosen, chosen)]
            found = np.linalg.solve(own, np.ones((outputs, size, 1)))[..., 0]
            found /= found.sum(axis=1, keepdims=True)
            variance = np.einsum("oi,oij,oj->o", found, own, found)
            better = (found >= 0).all(axis=1) & (variance < least)
            least[better] = variance[better]
            shares[:, better] = 0.0
            shares[np.ix_(chosen, better)] = found[better].T
    return shares
