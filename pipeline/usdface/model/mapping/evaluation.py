"""Errors of weights with respect to a truth, on a rig."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.model.mapping.regions import FACE
from usdface.model.placement.shape_parts import shape_parts
from usdface.numerics.measure.face_regions import (
    blinks,
    gaze_and_tongue_shapes,
    gaze_shapes,
    jaw_opener,
    points_by_region,
    region_gram,
    shapes_by_region,
    tongue_shapes,
)
from usdface.numerics.measure.performance_error import (
    LipError,
    ShapeErrors,
    SurfaceError,
    blink_peak_bias,
    find_lip_pairs,
    gap_of_keys,
    measure_lips,
    measure_shapes,
    relative_jitter,
)
from usdface.numerics.regression.cross_validation import surface_errors_mm, weight_rmse


@dataclass(frozen=True)
class SkinMetric:
    """Surface errors on the skin of a rig, without gaze and tongue, which markers do not show."""

    rig: Rig
    deformer: Deformer

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Part of the face of each shape; see `shape_parts`."""
        return shape_parts(self.rig, self.deformer)

    @cached_property
    def excluded_parts(self) -> dict[str, IntArray]:
        """Columns of the excluded shapes: ``'gaze'`` and ``'tongue'``, if the rig has them."""
        columns = {"gaze": gaze_shapes(self.parts), "tongue": tongue_shapes(self.parts)}
        return {name: shapes for name, shapes in columns.items() if len(shapes)}

    @cached_property
    def excluded(self) -> IntArray:
        """Columns of all excluded shapes."""
        return gaze_and_tongue_shapes(self.parts)

    @property
    def observable(self) -> BoolArray:
        """Which shapes are not excluded: (shapes,)."""
        return np.isin(np.arange(len(self.parts)), self.excluded, invert=True)

    @cached_property
    def points(self) -> dict[str, IntArray]:
        """Points of the rig by region, the whole face first; see `points_by_region`."""
        shapes = self.deformer.shapes
        return {FACE: shapes.face_points} | points_by_region(shapes.target_offsets(), self.parts)

    @cached_property
    def grams(self) -> FloatArray:
        """Gram matrix of the keys' displacements per region: (regions, keys, keys) [mm^2]."""
        shapes = self.deformer.shapes
        return np.stack([region_gram(shapes.key_offsets, each) for each in self.points.values()])

    def differences(self, weights: FloatArray, others: FloatArray) -> FloatArray:
        """Return differences of the keys' weights, 0 for excluded shapes: (frames, keys).

        `weights`, `others`: (frames, shapes), NaN where unknown.
        """
        skin_weights = weights.copy()
        skin_weights[:, self.excluded] = others[:, self.excluded]
        return self._key_differences(skin_weights, others)

    def _key_differences(self, weights: FloatArray, others: FloatArray) -> FloatArray:
        shapes = self.deformer.shapes
        differences = np.full((len(weights), shapes.key_offsets.shape[0]), np.nan)
        known = np.isfinite(weights).all(axis=1) & np.isfinite(others).all(axis=1)
        differences[known] = shapes.key_weights(weights[known]) - shapes.key_weights(others[known])
        return differences

    def excluded_mm(self, weights: FloatArray, others: FloatArray) -> dict[str, float]:
        """Return the surface error of each excluded part alone: mean over the frames [mm]."""
        errors = {}
        for name, columns in self.excluded_parts.items():
            part_weights = others.copy()
            part_weights[:, columns] = weights[:, columns]
            differences = self._key_differences(part_weights, others)
            differences = differences[np.isfinite(differences).all(axis=1)]
            errors[name] = float(surface_errors_mm(differences, self.grams[0]).mean())
        return errors


@dataclass(frozen=True)
class RegionError:
    """Errors of one part of the face."""

    name: str
    shape_count: int
    """Number of compared shapes of that part; see `shape_parts`."""
    weight_rmse: float
    """Over its observable shapes; NaN without any."""
    skin: SurfaceError
    surface: SurfaceError
    """`skin`, `surface`: Over the points that those shapes move most, without and with gaze and
    tongue."""


@dataclass(frozen=True)
class Evaluation:
    """Errors of a performance."""

    frames: IntArray
    """(frames,): frame numbers that were compared, ascending."""
    shape_names: tuple[str, ...]
    """Shapes that were compared."""
    observable: BoolArray
    """(shapes,): those included in `weight_rmse`."""
    weight_rmse: float
    """Over frames and observable shapes."""
    skin: SurfaceError
    """Of the whole rig, without gaze and tongue: the figure of sheets and reports."""
    surface: SurfaceError
    """Of the whole rig, with gaze and tongue."""
    excluded_mm: dict[str, float]
    """Surface error of ``'gaze'`` and ``'tongue'`` alone, if the rig has them: mean over the frames
    [mm]."""
    regions: tuple[RegionError, ...]
    """Empty if no shape is assigned to a part of the face."""
    shapes: ShapeErrors
    shape_mm: FloatArray
    """(shapes,): surface error of each shape alone, root mean square [mm]."""
    lips: LipError | None
    """None if the rig has no shapes of jaw and mouth."""
    blink_bias: float
    """Mean error of blinks at their peaks; NaN without blinks."""
    jitter: float
    """Roughness relative to the truth's; NaN without four consecutive frames."""


def evaluate_weights(
    rig: Rig,
    solved: FloatArray,
    truth: FloatArray,
    *,
    frames: IntArray,
    compared: BoolArray,
    observable: BoolArray | None = None,
) -> Evaluation:
    """Return the errors of weights with respect to the truth.

    Parameters
    ----------
    solved, truth : (frames, shapes) float arrays
        In the rig's order; 0 for shapes that are not compared.
    frames : (frames,) int array
        Frame numbers, ascending.
    compared : (shapes,) bool array
        Shapes that either side drives.
    observable : (shapes,) bool array, optional
        Shapes included in `weight_rmse`: by default all but gaze and tongue.
    """
    if not len(frames) or not compared.any():
        raise InputError("no frame or no shape to compare")
    if not (np.isfinite(solved).all() and np.isfinite(truth).all()):
        raise InputError("weights to compare must be finite")
    deformer = Deformer(rig)
    skin = SkinMetric(rig, deformer)
    observable = skin.observable if observable is None else observable
    offsets, targets = deformer.shapes.key_offsets, deformer.shapes.target_offsets()
    solved_keys, truth_keys = map(deformer.shapes.key_weights, (solved, truth))
    key_errors, skin_errors = solved_keys - truth_keys, skin.differences(solved, truth)
    errors = solved - truth
    by_region, counted = shapes_by_region(skin.parts), compared & observable
    grams = dict(zip(skin.points, skin.grams, strict=True))
    regions = [
        RegionError(
            name=name,
            shape_count=int(compared[by_region[name]].sum()),
            weight_rmse=weight_rmse(errors[:, by_region[name][counted[by_region[name]]]]),
            skin=SurfaceError(surface_errors_mm(skin_errors, gram)),
            surface=SurfaceError(surface_errors_mm(key_errors, gram)),
        )
        for name, gram in grams.items()
        if name != FACE
    ]
    lips = None
    opener = jaw_opener(skin.parts)
    if opener is not None and "mouth" in by_region:
        pairs = find_lip_pairs(deformer.neutral, targets, jaw_open=opener, mouth=by_region["mouth"])
        if pairs is not None:
            gap = gap_of_keys(pairs, offsets)
            lips = measure_lips(truth_keys, solved_keys, gap, rest_mm=pairs.rest_mm)
    shapes = measure_shapes(errors[:, compared])
    size_mm = np.sqrt(np.diag(deformer.shapes.gram()))[compared]
    return Evaluation(
        frames=frames,
        shape_names=tuple(name for name, used in zip(rig.shapes, compared, strict=True) if used),
        observable=observable[compared],
        weight_rmse=weight_rmse(errors[:, counted]),
        skin=SurfaceError(surface_errors_mm(skin_errors, grams[FACE])),
        surface=SurfaceError(surface_errors_mm(key_errors, grams[FACE])),
        excluded_mm=skin.excluded_mm(solved, truth),
        regions=tuple(regions),
        shapes=shapes,
        shape_mm=shapes.rmse * size_mm,
        lips=lips,
        blink_bias=blink_peak_bias(errors, truth, blinks(rig.shapes)),
        jitter=relative_jitter(solved[:, compared], truth[:, compared], frames),
    )
