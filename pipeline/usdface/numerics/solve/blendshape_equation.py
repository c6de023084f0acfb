"""Solve the blendshape equation for weights, from the motion of virtual markers.

Deng et al. 2006, section 7, equation 7: ``B = B0 + sum_i w_i B_i`` at the virtual markers, with the
performer's motion scaled by the proportions of the two faces. Plain least squares is the baseline
of the paper's comparison. Within the rig's ranges, and with a prior that shapes are used where
their markers move, the solution is a starting pose for an animator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray, equal_rows
from usdface.numerics.solve.bounded_least_squares import solve_bounded_least_squares

_MOST_RELINEARISATIONS = 8
_SMALL_STEP = 1e-6
"""Step of a weight for forward differences, which are exact, as in-betweens are piecewise linear.
"""
_SLOPE_DECIMALS = 4
"""Smaller differences of slopes are rounding."""
_DEPENDENT_RIDGE = 0.01
"""[of a shape's mean energy] Selects a small solution where shapes are dependent."""


@dataclass(frozen=True)
class EquationSolution:
    """Weights and their residuals."""

    weights: FloatArray
    """(frames, shapes)"""
    residual_mm: FloatArray
    """(frames, markers): distance between each marker and its position under the weights; NaN where
    it was not visible."""


@dataclass(frozen=True)
class MarkerKeys:
    """In-betweens at the virtual markers."""

    deltas: FloatArray
    """(keys, markers, 3): displacements by each key, with full targets [mm]."""
    channels: IntArray
    """(keys,): the shape of each key; -1 for a key that several shapes drive."""
    key_weights: Callable[[FloatArray], FloatArray]
    """Maps weights of shapes (frames, shapes) to weights of keys (frames, keys); piecewise linear.
    """
    linear: bool = False
    """Whether the map is linear, so that the equation has the same slopes everywhere."""

    def move(self, key_weights: FloatArray) -> FloatArray:
        """Return displacements by weights of keys: (frames, markers, 3) [mm]."""
        return np.asarray(np.einsum("fk,kmc->fmc", key_weights, self.deltas, optimize=True))


def solve_weights(
    deltas: ArrayLike,
    motion: ArrayLike,
    *,
    ranges: ArrayLike | None = None,
    visible: ArrayLike | None = None,
    marker_trust: ArrayLike | None = None,
    ridge: float = 0.0,
    keys: MarkerKeys | None = None,
    noise_mm: float = 0.0,
    tied: Sequence[Sequence[int]] = (),
) -> EquationSolution:
    """Solve the blendshape equation for every frame, within ranges.

    Minimises ``sum_m trust_m |motion_m - sum_i w_i delta_im|^2 + ridge |w|^2
    + 2 sum_i cost_i |w_i|``, in mm^2, where ``cost_i = noise^2 size_i / (seen_i + noise)``.
    ``size_i`` is the displacement of its markers by shape i, ``seen_i`` their displacement in the
    frame: root mean squares over the markers, weighted by the energy ``|delta_im|^2``. If ``noise``
    were the error per axis, this would be the maximum a posteriori solution for exponentially
    distributed weights, whose mean moves a shape's markers as far as they have moved; a distance
    in space, as here, weights the cost up to three times as much (decision 18). So a shape whose
    markers are still is not used for motion elsewhere, and the cost of one whose markers move far
    is near 0.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        Displacements of the virtual markers by each shape at 1 [mm].
    motion : (frames, markers, 3) array
        Displacements from the neutral face, in the character's space and proportions [mm].
    ranges : (shapes, 2) array, optional
        Lowest and highest weights; 0 to 1 unless given.
    visible : (frames, markers) bool array, optional
        Markers in each frame's equation.
    marker_trust : (markers,) array, optional
        Weight of each marker in the sum, not negative; 1 unless given.
    ridge : float, optional
        Penalty [mm^2], not negative.
    keys : MarkerKeys, optional
        In-betweens: the equation is linearised again about each solution.
    noise_mm : float, optional
        Expected residual of a marker under the true weights, a distance in space; 0 for no cost.
    tied : sequence of sequences of int, optional
        Shapes that share one weight.
    """
    problem = _checked(deltas, motion, visible, marker_trust)
    if problem.rank() < problem.shape_count:  # the solution is not unique
        energy = float(np.einsum("smc,m,smc->", problem.deltas, problem.share, problem.deltas))
        ridge = max(ridge, _DEPENDENT_RIDGE * energy / problem.shape_count)
    limits = np.asarray([[0.0, 1.0]] * problem.shape_count if ranges is None else ranges, float)
    variables = _variables(limits, problem.shape_count, tied, split=noise_mm > 0)
    prior = _Prior(ridge, _local_cost(problem, noise_mm))
    weights = _solve_bounded(problem, prior, variables, problem.deltas, problem.motion)
    if keys is not None:
        weights = _relinearise(problem, keys, weights, prior, variables)
    residual = np.linalg.norm(problem.motion - _predict(problem.deltas, keys, weights), axis=2)
    residual[~problem.visible] = np.nan
    return EquationSolution(weights, residual)


@dataclass(frozen=True)
class _Prior:
    """Costs of weights [mm^2]: ``ridge w^2 + 2 cost |w|``, `cost` (frames, shapes)."""

    ridge: float
    cost: FloatArray


@dataclass(frozen=True)
class _Variables:
    """Variables of a bounded solve.

    Tied shapes are one variable. If absolute values have a cost, a shape with a range on both sides
    of 0 is two, so that no variable is negative.
    """

    spread: sparse.csr_array
    """(variables, shapes): ``weights = variables @ spread``; entries 1, -1 or 0."""
    lower: FloatArray
    upper: FloatArray
    """`lower`, `upper`: (variables,)"""


def _variables(
    limits: FloatArray, shapes: int, tied: Sequence[Sequence[int]], *, split: bool
) -> _Variables:
    low, high = limits.T
    leader = np.arange(shapes)
    for group in tied:
        leader[list(group)] = min(group)
    member = leader == np.unique(leader)[:, None]
    spread = member.astype(float)
    lower = np.where(member, low, -np.inf).max(axis=1, initial=-np.inf)
    upper = np.where(member, high, np.inf).min(axis=1, initial=np.inf)
    if not split:
        return _Variables(sparse.csr_array(spread), lower, upper)
    up, down = (upper > 0) | (lower >= 0), lower < 0
    return _Variables(
        sparse.csr_array(np.concatenate([spread[up], -spread[down]])),
        np.concatenate([np.maximum(lower[up], 0.0), np.maximum(-upper[down], 0.0)]),
        np.concatenate([upper[up], -lower[down]]),
    )


def _local_cost(problem: "_Problem", noise_mm: float) -> FloatArray:
    """Return the costs of `solve_weights`: (frames, shapes) [mm^2]."""
    energy = (problem.deltas**2).sum(axis=2)
    moved = (problem.motion**2).sum(axis=2)
    total = np.maximum(problem.trust @ energy.T, np.finfo(float).tiny)
    size = np.sqrt(problem.trust @ (energy**2).T / total)
    seen = np.sqrt((problem.trust * moved) @ energy.T / total)
    return np.asarray(noise_mm**2 * size / np.maximum(seen + noise_mm, np.finfo(float).tiny))


def solve_least_squares(
    deltas: ArrayLike,
    motion: ArrayLike,
    *,
    visible: ArrayLike | None = None,
    marker_trust: ArrayLike | None = None,
) -> FloatArray:
    """Return the weights of smallest residual, as published; see `solve_weights`."""
    problem = _checked(deltas, motion, visible, marker_trust)
    weights = np.zeros((problem.frame_count, problem.shape_count))
    for rows in equal_rows(problem.trust):
        A, b = _stacked(problem, rows, problem.deltas, problem.motion)
        weights[rows] = np.asarray(np.linalg.lstsq(A.T, b.T)[0]).T
    return weights


def _solve_bounded(
    problem: "_Problem",
    prior: _Prior,
    variables: _Variables,
    deltas: FloatArray,
    motion: FloatArray,
    rows: IntArray | None = None,
) -> FloatArray:
    """Solve frames within bounds, for the shapes' slopes `deltas` and the remaining `motion`."""
    chosen = np.arange(problem.frame_count) if rows is None else rows
    spread, out = variables.spread, np.zeros((len(chosen), problem.shape_count))
    for group in equal_rows(problem.trust[chosen]):
        A, b = _stacked(problem, chosen[group], deltas, motion)
        solved = solve_bounded_least_squares(
            (spread @ A).T,
            b,
            lower=variables.lower,
            upper=variables.upper,
            # Of the two variables of a shape one is 0 at the optimum: the ridge applies to each.
            ridge=prior.ridge * abs(spread).sum(axis=1),
            cost=prior.cost[chosen[group]] @ abs(spread).T,
        )
        out[group] = solved @ spread
    return out


def _stacked(
    problem: "_Problem", rows: IntArray, deltas: FloatArray, motion: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return shapes and motion of frames that share one trust, as rows of coordinates."""
    root = np.sqrt(problem.trust[rows[0]])[:, None]
    return (deltas * root).reshape(len(deltas), -1), (motion[rows] * root).reshape(len(rows), -1)


def _relinearise(
    problem: "_Problem", keys: MarkerKeys, weights: FloatArray, prior: _Prior, variables: _Variables
) -> FloatArray:
    """Solve again with the slopes of shapes at the last solution, while the objective decreases.

    A frame has converged if its slopes are those it was solved with, as in-betweens are piecewise
    linear; without in-betweens, all frames have.
    """
    channels = np.asarray(keys.channels, np.int64)
    driven = channels < 0
    best, now = weights.copy(), weights.copy()
    objective = _objective(problem, keys, weights, prior)
    first = np.where(driven, 0.0, keys.key_weights(np.ones((1, problem.shape_count))))
    solved_with = np.repeat(first, len(weights), 0)
    rows = np.arange(len(weights))
    for _ in range(_MOST_RELINEARISATIONS):
        here = keys.key_weights(now[rows])
        # One step of all shapes gives the slope of every key that belongs to one shape; a key that
        # several shapes drive is constant.
        slopes = (keys.key_weights(now[rows] + _SMALL_STEP) - here) / _SMALL_STEP
        slopes = np.where(driven, 0.0, slopes.round(_SLOPE_DECIMALS))
        state = np.where(driven, here, slopes).round(_SLOPE_DECIMALS)
        changed = (state != solved_with[rows].round(_SLOPE_DECIMALS)).any(axis=1)
        rows, here, slopes = rows[changed], here[changed], slopes[changed]
        if not len(rows):
            break
        solved_with[rows] = state[changed]
        offset = here - slopes * now[rows][:, channels]
        part = problem.take(rows)
        rest = part.motion - keys.move(offset)
        costs = _Prior(prior.ridge, prior.cost[rows])
        for group in equal_rows(slopes):
            bent = np.zeros_like(problem.deltas)
            np.add.at(bent, channels, slopes[group[0], :, None, None] * keys.deltas)
            now[rows[group]] = _solve_bounded(part, costs, variables, bent, rest, group)
        after = _objective(part, keys, now[rows], costs)
        better = after < objective[rows]
        best[rows[better]] = now[rows[better]]
        objective[rows] = np.minimum(objective[rows], after)
        if not better.any():
            break
    return best


def _predict(deltas: FloatArray, keys: MarkerKeys | None, weights: FloatArray) -> FloatArray:
    if keys is None:
        return np.asarray(np.einsum("fs,smc->fmc", weights, deltas, optimize=True))
    return keys.move(keys.key_weights(weights))


def _objective(
    problem: "_Problem", keys: MarkerKeys, weights: FloatArray, prior: _Prior
) -> FloatArray:
    off = ((problem.motion - _predict(problem.deltas, keys, weights)) ** 2).sum(axis=2)
    misfit = (off * problem.trust).sum(axis=1)
    costs = prior.ridge * weights**2 + 2 * prior.cost * np.abs(weights)
    return np.asarray(misfit + costs.sum(axis=1))


@dataclass(frozen=True)
class _Problem:
    deltas: FloatArray
    motion: FloatArray
    visible: BoolArray
    share: FloatArray
    """(markers,): trust of each marker when visible."""
    trust: FloatArray
    """(frames, markers): 0 where a marker is not visible."""

    @property
    def frame_count(self) -> int:
        return len(self.motion)

    @property
    def shape_count(self) -> int:
        return len(self.deltas)

    def take(self, rows: IntArray) -> "_Problem":
        """Return some of the frames."""
        return replace(
            self, motion=self.motion[rows], visible=self.visible[rows], trust=self.trust[rows]
        )

    def rank(self) -> int:
        """Return the rank of the equation with all trusted markers."""
        trusted = self.deltas[:, self.share > 0].reshape(self.shape_count, -1)
        return int(np.linalg.matrix_rank(trusted)) if trusted.size else 0


def _checked(
    deltas: ArrayLike, motion: ArrayLike, visible: ArrayLike | None, trust: ArrayLike | None
) -> _Problem:
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    seen = np.ones(m.shape[:2], bool) if visible is None else np.asarray(visible, bool)
    share = np.ones(m.shape[1]) if trust is None else np.asarray(trust, float)
    m = np.where(seen[:, :, None], m, 0.0)
    if not np.isfinite(m).all():
        frame = int(np.flatnonzero(~np.isfinite(m).all(axis=(1, 2)))[0])
        raise ValueError(f"motion is not finite at index {frame}; mark unseen markers in visible")
    return _Problem(D, m, seen, share, seen * share)
