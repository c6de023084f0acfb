"""Weights against what they should have been, on a rig."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.numerics.measure.face_regions import (
    blinks,
    jaw_opener,
    points_by_region,
    region_gram,
    shapes_by_region,
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
    measure_surface,
    measure_weights,
    relative_jitter,
)


@dataclass(frozen=True)
class RegionError:
    """Errors of one part of the face."""

    name: str
    shape_count: int
    """Shapes whose name names it."""
    weight_rmse: float
    """Of those that count; NaN where none does."""
    surface: SurfaceError
    """Of the points that those shapes move most."""


@dataclass(frozen=True)
class Evaluation:
    """What a performance's errors come to."""

    frames: IntArray
    """(frames,): frame numbers that were compared, ascending."""
    shape_names: tuple[str, ...]
    """Shapes that were compared."""
    observable: BoolArray
    """(shapes,): those whose weights count."""
    weight_rmse: float
    """Over frames and the shapes that count."""
    surface: SurfaceError
    """Of the whole rig."""
    regions: tuple[RegionError, ...]
    """Empty where no shape's name names a part of the face."""
    shapes: ShapeErrors
    shape_mm: FloatArray
    """(shapes,): what each shape's error alone does to the surface, root mean square [mm]."""
    lips: LipError | None
    """None where the rig has no mouth that a jaw opens."""
    blink_bias: float
    """Mean error of blinks at their peaks; NaN where there is none."""
    jitter: float
    """Roughness relative to the truth's; NaN where no four frames follow each other."""


def evaluate_weights(
    rig: Rig,
    solved: FloatArray,
    truth: FloatArray,
    *,
    frames: IntArray,
    compared: BoolArray,
    observable: BoolArray,
) -> Evaluation:
    """Measure weights against what they should have been.

    Parameters
    ----------
    solved, truth : (frames, shapes) float arrays
        In the rig's order; 0 for shapes that are not compared.
    frames : (frames,) int array
        Frame numbers, ascending.
    compared : (shapes,) bool array
        Shapes that either side drives.
    observable : (shapes,) bool array
        Of those, the ones whose weights count: markers cannot show where the eyes look.
    """
    if not len(frames) or not compared.any():
        raise InputError("no frame or no shape to compare")
    if not (np.isfinite(solved).all() and np.isfinite(truth).all()):
        raise InputError("weights to compare must be finite")
    deformer = Deformer(rig)
    bent = deformer.shapes.is_bent
    targets = deformer.shapes.target_offsets()
    offsets = deformer.shapes.key_offsets if bent else targets
    solved_keys = deformer.shapes.key_weights(solved) if bent else solved
    truth_keys = deformer.shapes.key_weights(truth) if bent else truth
    key_errors = solved_keys - truth_keys
    errors = solved - truth
    by_region = shapes_by_region(rig.shapes)
    regions = [
        RegionError(
            name=name,
            shape_count=int(compared[by_region[name]].sum()),
            weight_rmse=measure_weights(
                errors[:, by_region[name]],
                observable=(compared & observable)[by_region[name]],
            ),
            surface=measure_surface(key_errors, region_gram(offsets, points)),
        )
        for name, points in points_by_region(targets, rig.shapes).items()
    ]
    lips = None
    opener = jaw_opener(rig.shapes)
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
        weight_rmse=measure_weights(errors, observable=compared & observable),
        surface=measure_surface(key_errors, region_gram(offsets, deformer.shapes.face_points)),
        regions=tuple(regions),
        shapes=shapes,
        shape_mm=shapes.rmse * size_mm,
        lips=lips,
        blink_bias=blink_peak_bias(errors, truth, blinks(rig.shapes)),
        jitter=relative_jitter(solved[:, compared], truth[:, compared], frames),
    )
