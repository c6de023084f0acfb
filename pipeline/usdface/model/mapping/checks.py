"""Validation of references before training."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import MotionSpace, References
from usdface.core.errors import InputError
from usdface.core.text import first_few, repeated

MINIMUM_PAIRS = 2


def check_references(
    references: References, *, ranges: FloatArray, gram: FloatArray | None
) -> References:
    """Return valid references: weights limited to their ranges, repeated pairs dropped.

    Raises
    ------
    InputError
        If arrays do not fit each other, hold values that are not finite, or no marker moves; all
        faults are listed.
    """
    faults = _shape_faults(references, ranges, gram)
    if not faults:
        faults = _value_faults(references)
    if faults:
        raise InputError("the references cannot be trained on:\n  " + "\n  ".join(faults))
    limited = np.clip(references.weights, ranges[:, 0], ranges[:, 1])
    return _without_repeats(replace(references, weights=limited))


def check_dimensions(choices: tuple[int, ...], *, pairs: int, motion: MotionSpace) -> None:
    """Refuse more dimensions than the pairs or the motion space support."""
    available = len(motion.components)
    for dimensions in choices:
        if dimensions < 1:
            raise InputError(f"dimensions must be at least 1, got {dimensions}")
        if dimensions > pairs - 1:
            raise InputError(
                f"{dimensions} dimensions need at least {dimensions + 1} references, got {pairs}; "
                "tune more frames or ask for fewer dimensions"
            )
        if dimensions > available:
            raise InputError(
                f"{dimensions} dimensions asked for but the takes' motion space has {available}; "
                "ask for fewer, or select from longer takes"
            )


def check_skin(skin: FloatArray | None, *, shapes: int) -> None:
    """Refuse skin whose shapes are not those of the references."""
    if skin is None:
        return
    if skin.ndim != 3 or skin.shape[0] != shapes or skin.shape[2] != 3:
        raise InputError(
            f"skin has shape {skin.shape}, the references have {shapes} shapes; sample the rig's "
            "shapes in the references' order"
        )
    if not np.isfinite(skin).all():
        raise InputError("skin holds values that are not finite; check the rig's blend shapes")


def pair_name(references: References, pair: int) -> str:
    """Return the name of a pair in messages: its number, take and frame."""
    return f"pair {pair + 1} (take {references.takes[pair]!r}, frame {references.frames[pair]})"


def _shape_faults(references: References, ranges: FloatArray, gram: FloatArray | None) -> list[str]:
    pairs = len(references.weights)
    markers, shapes = len(references.marker_names), len(references.shape_names)
    if pairs < MINIMUM_PAIRS:
        return [
            f"{pairs} pairs: at least {MINIMUM_PAIRS} are needed, and 25 to 100 for a face; "
            "tune more frames"
        ]
    expected = {
        "markers": (references.markers.shape, (pairs, markers, 3)),
        "weights": (references.weights.shape, (pairs, shapes)),
        "neutral": (references.neutral.shape, (markers, 3)),
        "ranges": (ranges.shape, (shapes, 2)),
        "gram": ((shapes, shapes) if gram is None else gram.shape, (shapes, shapes)),
        "frames": (references.frames.shape, (pairs,)),
        "takes": ((len(references.takes),), (pairs,)),
    }
    faults = [
        f"{name} has shape {got}, not {want}"
        for name, (got, want) in expected.items()
        if got != want
    ]
    for kind, names in (("marker", references.marker_names), ("shape", references.shape_names)):
        if twice := repeated(names):
            faults.append(f"{kind} names are not unique: {first_few(sorted(twice))}; rename them")
    if references.motion is not None and references.motion.components.shape[1] != 3 * markers:
        faults.append(
            f"the motion space has {references.motion.components.shape[1] // 3} markers, the "
            f"pairs have {markers}; select the references again"
        )
    if not faults and not (ranges[:, 0] < ranges[:, 1]).all():
        bad = int(np.flatnonzero(~(ranges[:, 0] < ranges[:, 1]))[0])
        faults.append(f"{references.shape_names[bad]} has the empty range {ranges[bad].tolist()}")
    if not faults and gram is not None and not np.isfinite(gram).all():
        faults.append("gram holds values that are not finite; check the rig's blend shapes")
    return faults


def _value_faults(references: References) -> list[str]:
    faults = []
    finite_markers = np.asarray(np.isfinite(references.markers).all(axis=2))
    for kind, finite, every, remedy in (
        ("markers", finite_markers, references.marker_names, "clean the take"),
        ("weights", np.isfinite(references.weights), references.shape_names, "tune them again"),
    ):
        for pair in np.flatnonzero(~finite.all(axis=1)).tolist():
            names = first_few([every[k] for k in np.flatnonzero(~finite[pair])], most=3)
            faults.append(f"{pair_name(references, pair)}: {kind} {names} are not finite; {remedy}")
    still = np.flatnonzero(~np.isfinite(references.neutral).all(axis=1))
    if len(still):
        names = first_few([references.marker_names[m] for m in still], most=3)
        faults.append(
            f"the neutral face: markers {names} are not finite; ingest the take again with "
            "another neutral frame"
        )
    motion = references.motion
    if motion is not None and not all(np.isfinite(each).all() for each in vars(motion).values()):
        faults.append("the motion space holds values that are not finite; select again")
    if faults:
        return faults
    if np.ptp(references.markers, axis=0).max() == 0:
        return ["no marker moves between the pairs; choose frames of different faces"]
    for first, second in _same_markers(references):
        if not np.array_equal(references.weights[first], references.weights[second]):
            faults.append(
                f"{pair_name(references, first)} and {pair_name(references, second)} have the same "
                "markers but different weights; keep one of them"
            )
    return faults


def _same_markers(references: References) -> list[tuple[int, int]]:
    """Return (first, repeat) for each pair whose markers equal those of an earlier one."""
    first: dict[bytes, int] = {}
    repeats = []
    for pair, markers in enumerate(references.markers):
        key = np.ascontiguousarray(markers).tobytes()
        if key in first:
            repeats.append((first[key], pair))
        else:
            first[key] = pair
    return repeats


def _without_repeats(references: References) -> References:
    repeated = {second for _, second in _same_markers(references)}
    kept = np.array([i for i in range(len(references.weights)) if i not in repeated])
    if len(kept) < MINIMUM_PAIRS:
        raise InputError("all pairs are the same frame; choose frames of different faces")
    return references.rows(kept)
