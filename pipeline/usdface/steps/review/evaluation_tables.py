"""An evaluation as lines of text, plain data and a picture's contents."""

import math
from itertools import islice

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, spaced_rows
from usdface.core.text import pluralize
from usdface.media.charts.evaluation import EvaluationPage, ShapeBar
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.mapping.evaluation import Evaluation
from usdface.model.mapping.regions import FACE
from usdface.model.review.verdict import SolveEvidence, judge_solve
from usdface.numerics.measure.performance_error import SurfaceError

WORST_FRAMES = 8
WORST_SHAPES = 10


def evaluation_summary(evaluation: Evaluation) -> str:
    """Return the main errors in one line."""
    excluded = evaluation.excluded_mm
    without = f" without {' and '.join(excluded)}" if excluded else ""
    facts = [
        f"{evaluation.skin.mean_mm:.3f} mm off the keys{without}",
        f"95th percentile {evaluation.skin.p95_mm:.3f} mm",
        *_unseen_facts(evaluation),
        f"{_number(evaluation.weight_rmse)} in the weights",
    ]
    return f"{pluralize(len(evaluation.frames), 'frame')}: {', '.join(facts)}"


def _unseen_facts(evaluation: Evaluation) -> list[str]:
    return [f"{name} alone {mm:.3f} mm" for name, mm in evaluation.excluded_mm.items() if mm]


def evaluation_table(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the figures as lines of a table: by region, lips, blinks and jitter, by shape."""
    lines = [f"{'region':<17}{'weights':>9}{'mean mm':>9}{'p95 mm':>9}{'largest mm':>11}"]
    parts: list[tuple[str, float, SurfaceError]] = [
        ("face", evaluation.weight_rmse, evaluation.skin)
    ]
    parts += [(region.name, region.weight_rmse, region.skin) for region in evaluation.regions]
    for name, weights, skin in parts:
        lines.append(
            f"{name:<17}{_number(weights):>9}{skin.mean_mm:>9.3f}{skin.p95_mm:>9.3f}"
            f"{skin.max_mm:>11.3f}"
        )
    lines += [f"{f'{name} alone':<26}{mm:>9.3f}" for name, mm in evaluation.excluded_mm.items()]
    lines.append("")
    if evaluation.lips is not None:
        closed = evaluation.lips.closed_bias_mm
        when_closed = (
            "" if math.isnan(closed) else f"; {closed:+.2f} mm where they should be closed"
        )
        lines.append(f"lips: error of the distance {evaluation.lips.rms_mm:.2f} mm{when_closed}")
    if not math.isnan(evaluation.blink_bias):
        lines.append(f"blinks at their peaks: {evaluation.blink_bias:+.3f}")
    if not math.isnan(evaluation.jitter):
        lines.append(f"jitter: {evaluation.jitter:.2f} of that of the keys")
    lines.append("worst frames: " + ", ".join(map(str, worst_frames(evaluation))))
    lines += ["", f"{'shape':<24}{'RMSE':>8}{'bias':>9}{'largest':>9}{'alone mm':>10}"]
    for column in _by_surface(evaluation)[:WORST_SHAPES]:
        lines.append(
            f"{evaluation.shape_names[column]:<24}{evaluation.shapes.rmse[column]:>8.3f}"
            f"{evaluation.shapes.bias[column]:>+9.3f}{evaluation.shapes.largest[column]:>9.3f}"
            f"{evaluation.shape_mm[column]:>10.3f}"
        )
    return tuple(lines)


def evaluation_figures(evaluation: Evaluation) -> dict[str, object]:
    """Return every figure as plain data; None for unknown ones."""
    lips = evaluation.lips
    return {
        "frames": {
            "count": len(evaluation.frames),
            "first": int(evaluation.frames[0]),
            "last": int(evaluation.frames[-1]),
        },
        "skin_mean_mm": evaluation.skin.mean_mm,
        **_surface_figures(evaluation.skin, "skin"),
        **{f"{name}_mean_mm": mm for name, mm in evaluation.excluded_mm.items()},
        "weight_rmse": _known(evaluation.weight_rmse),
        **_surface_figures(evaluation.surface, "vertex"),
        "lip_error_mm": None if lips is None else lips.rms_mm,
        "lip_closed_bias_mm": None if lips is None else _known(lips.closed_bias_mm),
        "blink_bias": _known(evaluation.blink_bias),
        "jitter": _known(evaluation.jitter),
        "worst_frames": list(worst_frames(evaluation)),
        "unobservable": [
            name
            for name, seen in zip(evaluation.shape_names, evaluation.observable, strict=True)
            if not seen
        ],
        "regions": [
            {
                "region": region.name,
                "shapes": region.shape_count,
                "skin_mean_mm": region.skin.mean_mm,
                **_surface_figures(region.skin, "skin"),
                "weight_rmse": _known(region.weight_rmse),
                **_surface_figures(region.surface, "vertex"),
            }
            for region in evaluation.regions
        ],
        "shapes": [
            {
                "shape": evaluation.shape_names[column],
                "rmse": float(evaluation.shapes.rmse[column]),
                "bias": float(evaluation.shapes.bias[column]),
                "largest": float(evaluation.shapes.largest[column]),
                "surface_mm": float(evaluation.shape_mm[column]),
            }
            for column in _by_surface(evaluation)
        ],
    }


def _surface_figures(error: SurfaceError, what: str) -> dict[str, float]:
    return {
        f"{what}_rms_mm": error.rms_mm,
        f"{what}_p95_mm": error.p95_mm,
        f"{what}_max_mm": error.max_mm,
    }


def evaluation_page(evaluation: Evaluation, *, title: str) -> EvaluationPage:
    """Return the contents of the picture of errors over time and by shape."""
    frames = evaluation.frames
    curves = [ErrorCurve("face", _over_time(frames, evaluation.skin.frames_mm))]
    curves += [
        ErrorCurve(region.name.split(" and ")[0], _over_time(frames, region.skin.frames_mm))
        for region in evaluation.regions
    ]
    facts = [f"frames {frames[0]}-{frames[-1]}", f"{_number(evaluation.weight_rmse)} in weights"]
    if not math.isnan(evaluation.blink_bias):
        facts.append(f"blinks {evaluation.blink_bias:+.3f} at their peaks")
    if not math.isnan(evaluation.jitter):
        facts.append(f"jitter {evaluation.jitter:.2f} of the keys'")
    lips = evaluation.lips
    errors = [evaluation.skin, *(region.skin for region in evaluation.regions)]
    evidence = SolveEvidence(
        (FACE, *(region.name for region in evaluation.regions)),
        error_mm=np.column_stack([each.frames_mm for each in errors]),
    )
    verdict = judge_solve(evidence)
    return EvaluationPage(
        title=title,
        verdict=(verdict.level, verdict.sentence),
        facts=(*facts, *_unseen_facts(evaluation)),
        curves=tuple(curves),
        first_frame=int(frames[0]),
        worst=worst_frames(evaluation),
        lips=None
        if lips is None
        else (_over_time(frames, lips.truth_mm), _over_time(frames, lips.solved_mm)),
        shapes=tuple(
            ShapeBar(
                evaluation.shape_names[column],
                float(evaluation.shapes.rmse[column]),
                float(evaluation.shapes.bias[column]),
                float(evaluation.shape_mm[column]),
            )
            for column in _by_surface(evaluation)
        ),
    )


def worst_frames(evaluation: Evaluation) -> tuple[int, ...]:
    """Return the frames of the largest skin error, at a distance from each other."""
    error = evaluation.skin.frames_mm
    apart = max(len(error) // (3 * WORST_FRAMES), 1)
    rows = islice(spaced_rows(np.argsort(-error, kind="stable"), apart), WORST_FRAMES)
    return tuple(int(evaluation.frames[row]) for row in rows)


def _by_surface(evaluation: Evaluation) -> list[int]:
    """Return the columns of shapes, the largest surface error first."""
    order: list[int] = np.lexsort((-evaluation.shapes.rmse, -evaluation.shape_mm)).tolist()
    return order


def _over_time(frames: IntArray, values: FloatArray) -> FloatArray:
    """Return values at all frames from first to last; NaN at frames not compared."""
    out = np.full(int(frames[-1] - frames[0]) + 1, np.nan)
    out[frames - frames[0]] = values
    return out


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4f}"


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
