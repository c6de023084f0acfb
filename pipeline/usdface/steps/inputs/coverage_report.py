"""Measure and draw the coverage of takes by references."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray, IntArray
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.text import pluralize
from usdface.media.charts.coverage import CoveragePage, NextFrame, draw_coverage
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.mapping.coverage import LEAST_COVERAGE, CoverageModel
from usdface.model.mapping.motion_space import marker_coordinates
from usdface.model.mapping.performer_face import face_of_references
from usdface.model.mapping.regions import membership, region_points
from usdface.model.selection.coverage import (
    Coverage,
    Growth,
    choose_next_frames,
    measure_coverage,
    measure_growth,
)
from usdface.model.selection.design import features_at
from usdface.numerics.rigid.rigid_alignment import FEWEST_RIGID
from usdface.steps.inputs.cleaned_takes import CleanedTakes, read_cleaned_takes
from usdface.steps.inputs.placement import stored_placement
from usdface.steps.inputs.scene import SelectionScene, candidate_frames, set_up_scene
from usdface.usdio.references.read import read_rig_of
from usdface.usdio.references.weight_layers import read_keyed_references

NEXT_FRAME_COUNT = 10
"""Number of frames to suggest."""

LEAST_MARKER_SHARE = 0.5
"""Smallest share of a take's markers that references must have."""


@dataclass(frozen=True)
class TakesCoverage:
    """Coverage of takes by pairs, and its growth with further frames."""

    takes: CleanedTakes
    frames: Coverage
    growth: Growth
    pairs: IntArray
    """(pairs,): indices of the pairs that count."""
    rows: IntArray
    """(n,): rows of the takes that are pairs."""
    tuned: IntArray
    """(m,): the tuned ones of `rows`."""
    tuned_count: int
    """Number of tuned pairs, including those of other takes."""
    notes: tuple[str, ...] = ()

    def next_frames(self) -> tuple[NextFrame, ...]:
        """Return the frames that would be chosen next."""
        growth = self.growth
        return tuple(
            NextFrame(
                take=self.takes.takes[row],
                frame=int(self.takes.frames[row]),
                coverage=float(self.frames.face[row]),
                mean_then=float(mean),
            )
            for row, mean in zip(growth.next_rows.tolist(), growth.next_share, strict=True)
        )

    def picture(self, title: str) -> ByteImage:
        """Draw the coverage."""
        frames, takes = self.frames, self.takes
        lanes = [ErrorCurve("whole face", 100 * (1 - frames.face))]
        if len(frames.regions) > 1:
            lanes += [
                ErrorCurve(region.split(" and ")[0], 100 * (1 - frames.by_region[:, index]))
                for index, region in enumerate(frames.regions)
            ]
        facts = (
            f"{len(self.pairs)} references, {len(self.tuned)} tuned",
            f"mean coverage {frames.mean:.0%}",
            f"{LEAST_COVERAGE:.0%} or more in {frames.sufficient_share:.0%} of the frames",
            f"{len(takes.frames)} frames of {pluralize(len(takes.sources), 'take')}",
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
                marks=tuple(sorted(self.rows.tolist())),
                growth=self.growth.share,
                next_frames=self.next_frames(),
            )
        )

    def figures(self) -> dict[str, object]:
        """Return coverage as plain data."""
        frames = self.frames
        return {
            "coverage": round(frames.mean, 4),
            "coverage_by_region": {
                region: round(float(frames.by_region[:, index].mean()), 4)
                for index, region in enumerate(frames.regions)
            },
            "uncovered_share": round(1 - frames.sufficient_share, 4),
            "growth": np.round(self.growth.share, 4).tolist(),
            "next": [
                {
                    "take": each.take,
                    "frame": each.frame,
                    "covered": round(each.coverage, 4),
                    "coverage_then": round(each.mean_then, 4),
                }
                for each in self.next_frames()
            ],
        }


def coverage_and_growth(
    scene: SelectionScene,
    features: FloatArray,
    displacements: FloatArray,
    *,
    candidates: BoolArray,
    rows: IntArray,
) -> tuple[Coverage, Growth]:
    """Measure the coverage of all frames by pairs.

    `features`, (pairs, d), and `displacements`, (pairs, markers, 3) from the neutral at the rig's
    size [mm]: of pairs of these takes or others. `candidates`: (frames,), which may be chosen next.
    `rows`: (n,), those that are pairs.
    """
    free = candidates.copy()
    free[rows] = False
    points = region_points(scene.parts, scene.equation.deltas)
    markers, count = scene.equation.deltas.shape[1], len(scene.features)
    model = CoverageModel(scene.equation.deltas, displacements, membership(points, markers))
    further = choose_next_frames(scene.features, features, count=NEXT_FRAME_COUNT, candidates=free)
    return (
        measure_coverage(model, tuple(points), scene.displacements, count),
        measure_growth(model, further, scene.displacements, count),
    )


def measure_pairs(
    file: Path, paths: tuple[Path, ...], *, tuned_only: bool = False, progress: Progress
) -> TakesCoverage:
    """Measure the coverage of takes by the pairs of a references asset."""
    references = read_keyed_references(file)
    pairs = np.arange(len(references.frames), dtype=np.int64)
    if tuned_only:
        pairs = np.flatnonzero(references.tuned)
        if not len(pairs):
            raise InputError(
                f"{file}: none of its {len(references.frames)} pairs is tuned; leave out "
                "--tuned-only for the coverage by all pairs"
            )
    takes = _with_markers_of(read_cleaned_takes(paths), references, file)
    rig = read_rig_of(references, file)
    scene = set_up_scene(takes, rig, placement=stored_placement(references, rig), progress=progress)
    progress(0.7, "measuring the coverage")
    # Pairs of other takes use the references' markers.
    places = [(references.takes[pair], int(references.frames[pair])) for pair in pairs.tolist()]
    found = takes.find_rows(places)
    is_here = np.array([row is not None for row in found], dtype=np.bool_)
    rows = np.array([row for row in found if row is not None], dtype=np.int64)
    features = np.empty((len(pairs), scene.features.shape[1]))
    displacements = np.empty((len(pairs), *takes.neutral.shape))
    features[is_here] = features_at(scene.features, rows)
    displacements[is_here] = scene.displacements(rows)
    if not is_here.all():
        columns = [references.marker_names.index(name) for name in takes.marker_names]
        space = takes.head_space(face_of_references(references))
        markers = space.restore(references.markers)[:, columns][pairs[~is_here]]
        features[~is_here] = scene.space.features(marker_coordinates(scene.motion, markers))
        displacements[~is_here] = scene.equation.motion(markers)
    coverage, growth = coverage_and_growth(
        scene, features, displacements, candidates=candidate_frames(takes, None), rows=rows
    )
    is_tuned = references.tuned[pairs]
    tuned, count = rows[is_tuned[is_here]], int(is_tuned.sum())
    notes = tuple(scene.notes)
    if not count:
        notes += (
            "no pair is tuned: pairs count by their markers, as if their weights fitted them; the "
            "coverage of a mapping trained on proposals may be lower. Tune them first",
        )
    return TakesCoverage(takes, coverage, growth, pairs, rows, tuned, count, notes)


def _with_markers_of(takes: CleanedTakes, references: References, file: Path) -> CleanedTakes:
    """Return takes with only the markers of the references, aligned by the rigid ones of these."""
    columns = [i for i, name in enumerate(takes.marker_names) if name in references.marker_names]
    names = tuple(takes.marker_names[i] for i in columns)
    rigid = tuple(name for name in takes.rigid if name in names)
    if len(names) < LEAST_MARKER_SHARE * len(takes.marker_names) or len(rigid) < FEWEST_RIGID:
        raise InputError(
            f"{file}: has {len(names)} of the takes' {len(takes.marker_names)} markers, "
            f"{len(rigid)} of them rigid; at least {LEAST_MARKER_SHARE:.0%} and {FEWEST_RIGID} "
            "rigid ones are needed. Give takes of the marker set that the references were selected "
            "from"
        )
    if len(names) < len(takes.marker_names):
        takes = replace(
            takes,
            marker_names=names,
            rigid=rigid,
            neutral=takes.neutral[columns],
            positions=tuple(clip[:, columns] for clip in takes.positions),
            usable=tuple(clip[:, columns] for clip in takes.usable),
        )
    steady = tuple(name for name in references.rigid if name in names)
    return takes if set(steady) == set(takes.rigid) else takes.aligned_by(steady)
