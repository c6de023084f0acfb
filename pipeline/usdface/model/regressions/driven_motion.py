"""Motion of a performer's markers due to the rig's combination shapes.

The rig evaluates the weights ``c(w)`` of its combinations; each moves the markers by ``F_c``. The
forward model is fitted to the displacements less ``c(w)' F``.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usdface.core.arrays import (
    Arrays,
    Float32Array,
    FloatArray,
    IntArray,
    RealArray,
    single_precision,
)
from usdface.core.rig_logic import COMBINATION_MODES, Combination, RigLogic
from usdface.model.regressions.bent_weights import unbend, unbend_slope
from usdface.model.regressions.shape_sides import ShapeSides


@dataclass(frozen=True)
class DrivenMotion:
    """Displacement of the markers as a function of the combinations' weights."""

    logic: RigLogic
    """Its first shapes are the mapping's, in order; any others stay at 0."""
    sides: ShapeSides
    """Columns of the bent weights, sides of the mapping's shapes."""
    motion: FloatArray
    """(combinations, 3 markers): ``F`` [mm]."""

    def displacements(
        self, targets: RealArray, curve: float, slope: Float32Array | None = None
    ) -> Float32Array:
        """Return the displacement of the markers: (frames, 3 markers) [mm].

        Parameters
        ----------
        targets : (frames, columns) float array
            Bent weights.
        slope : (frames, columns, 3 markers) float32 array, optional
            Jacobian, to which the derivatives are added in place.
        """
        bent, (low, high) = targets.astype(np.float64), self.sides.ranges.T
        weights = self.sides.join(low + (high - low) * np.clip(unbend(bent, curve), 0.0, 1.0))
        values = self.logic.evaluate(pad_columns(weights, len(self.logic.shapes)))
        if slope is not None:
            slopes = single_precision(unbend_slope(bent, curve) * (high - low) * self.sides.signs)
            link_slopes = single_precision(self.logic.link_slopes(values))
            for column, links in enumerate(self._links_of_column):
                if len(links):
                    chained = link_slopes[:, links] * slopes[:, [column]]
                    slope[:, column] += chained @ self._link_motion[links]
        combinations = single_precision(values[:, len(self.logic.shapes) :])
        return np.asarray(combinations @ self._motion32)

    @cached_property
    def _motion32(self) -> Float32Array:
        return single_precision(self.motion)

    @cached_property
    def _link_motion(self) -> Float32Array:
        return self._motion32[self.logic.links[:, 0]]

    @cached_property
    def _links_of_column(self) -> list[IntArray]:
        """Rows of the logic's links that the shape of each column drives."""
        return [np.flatnonzero(self.logic.links[:, 1] == shape) for shape in self.sides.shapes]

    def to_arrays(self) -> Arrays:
        """Return the combinations as arrays of a mapping, the input of `from_arrays`."""
        combinations = self.logic.combinations
        names = [*self.logic.shapes, *(combination.shape for combination in combinations)]
        column = {name: index for index, name in enumerate(names)}
        part_count = max(len(combination.parts) for combination in combinations)
        parts = np.full((len(self.motion), part_count), -1.0)
        weights, modes = np.ones_like(parts), np.zeros(len(parts))
        spans = np.zeros((*parts.shape, 2))  # all 0: spans follow from neighbouring in-betweens
        for row, combination in enumerate(combinations):
            count = len(combination.parts)
            parts[row, :count] = [column[part] for part in combination.parts]
            weights[row, :count] = combination.part_weights
            spans[row, :count] = combination.spans or 0.0
            modes[row] = COMBINATION_MODES.index(combination.mode)
        return {
            "driven_shapes": np.array([float(len(self.logic.shapes))]),
            "driven_parts": parts,
            "driven_weights": weights,
            "driven_spans": spans,
            "driven_modes": modes,
            "driven_ranges": self.sides.limits,
            "driven_motion": self.motion,
        }

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "DrivenMotion | None":
        """Rebuild the combinations from the arrays of a mapping; None if its rig had none."""
        if "driven_parts" not in arrays:
            return None
        count = int(arrays["driven_shapes"][0])
        combinations = []
        fields = [arrays[f"driven_{name}"] for name in ("parts", "weights", "spans", "modes")]
        for row, (parts, weights, spans, mode) in enumerate(zip(*fields, strict=True)):
            used = parts >= 0
            combinations.append(
                Combination(
                    str(count + row),
                    tuple(str(int(part)) for part in parts[used]),
                    COMBINATION_MODES[int(mode)],
                    tuple(weights[used].tolist()),
                    tuple(map(tuple, spans[used].tolist())) if spans.any() else (),
                )
            )
        logic = RigLogic([str(shape) for shape in range(count)], combinations)
        sides = ShapeSides.from_arrays(arrays, arrays["driven_ranges"])
        return cls(logic, sides, arrays["driven_motion"])


def driven_weights(logic: RigLogic, weights: FloatArray) -> FloatArray:
    """Return the weights of the combinations: (frames, combinations).

    `weights`: (frames, shapes), of the first shapes of the logic; the others are 0.
    """
    padded = pad_columns(weights, len(logic.shapes))
    return logic.evaluate(padded)[:, len(logic.shapes) :]


def pad_columns(weights: FloatArray, count: int) -> FloatArray:
    """Pad weights with columns of 0 to `count` columns."""
    return np.pad(weights, ((0, 0), (0, count - weights.shape[1])))
