"""Coverage measured, drawn and told: what `select` and `references coverage` share."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray, IntArray
from usdface.media.charts.coverage import CoveragePage, Hole, draw_coverage
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.selection.coverage import Coverage, Growth, measure_coverage, measure_growth
from usdface.model.selection.features import Features, SelectionSpace, features_at
from usdface.steps.inputs.cleaned_takes import CleanedTakes

FURTHER = 10
"""How many frames to look ahead."""


@dataclass(frozen=True)
class Covered:
    """What pairs cover of takes, and what would help."""

    coverage: Coverage
    growth: Growth


def cover(
    space: SelectionSpace,
    features: Features,
    rows: IntArray,
    *,
    candidates: BoolArray,
    pair_features: FloatArray | None = None,
) -> Covered:
    """Measure coverage of all frames by pairs at some rows, or with features of their own."""
    pairs = features_at(features, rows) if pair_features is None else pair_features
    free = candidates.copy()
    free[rows] = False
    return Covered(
        measure_coverage(space, features, pairs),
        measure_growth(features, pairs, further=FURTHER, candidates=free),
    )


def holes_of(covered: Covered, takes: CleanedTakes) -> tuple[Hole, ...]:
    """Return the frames that would be chosen next."""
    return tuple(
        Hole(
            take=takes.takes[row],
            frame=int(takes.frames[row]),
            covered=float(covered.coverage.covered[row]),
            share=float(share),
        )
        for row, share in zip(
            covered.growth.further_rows.tolist(), covered.growth.further_share, strict=True
        )
    )


def coverage_picture(
    covered: Covered,
    takes: CleanedTakes,
    rows: IntArray,
    *,
    tuned: IntArray,
    title: str,
    pairs: int | None = None,
) -> ByteImage:
    """Draw it; `pairs` counts those of other takes as well, which have no row."""
    coverage = covered.coverage
    lanes = [ErrorCurve("whole face", 100 * (1 - coverage.covered))]
    if len(coverage.regions) > 1:
        lanes += [
            ErrorCurve(region.split(" and ")[0], 100 * (1 - coverage.region_covered[:, index]))
            for index, region in enumerate(coverage.regions)
        ]
    facts = (
        f"{len(rows) if pairs is None else pairs} references, {len(tuned)} tuned",
        f"{coverage.share:.1%} of the motion covered",
        f"{coverage.hole_share:.1%} of the frames are holes",
        f"{len(takes.frames)} frames of {len(takes.sources)} "
        + ("take" if len(takes.sources) == 1 else "takes"),
    )
    return draw_coverage(
        CoveragePage(
            title=f"Coverage of {title}",
            facts=facts,
            lanes=tuple(lanes),
            takes=tuple(
                (source.name, len(clip))
                for source, clip in zip(takes.sources, takes.positions, strict=True)
            ),
            first_frame=int(takes.frames[0]),
            marks=tuple(sorted(rows.tolist())),
            growth=covered.growth.share,
            holes=holes_of(covered, takes),
        )
    )


def coverage_figures(covered: Covered, takes: CleanedTakes) -> dict[str, object]:
    """Return coverage as plain data."""
    coverage = covered.coverage
    return {
        "coverage": round(coverage.share, 4),
        "coverage_by_region": {
            region: round(float(coverage.region_covered[:, index].mean()), 4)
            for index, region in enumerate(coverage.regions)
        },
        "hole_share": round(coverage.hole_share, 4),
        "growth": np.round(covered.growth.share, 4).tolist(),
        "next": [
            {
                "take": hole.take,
                "frame": hole.frame,
                "covered": round(hole.covered, 4),
                "coverage_then": round(hole.share, 4),
            }
            for hole in holes_of(covered, takes)
        ],
    }
