"""Calibration of uncertainty: predicted and true errors.

A mapping predicts an uncertainty of the face and each region for every frame; 90 % of the errors
should be within 1.645 of it. The share is measured on frames with known weights: the second half of
`crosstake` at three levels of noise, and three takes of each performer of `performers`, whose keys
are exact, or have random errors, and of performers that chose nothing.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from benchmarks.performers import PERFORMERS, UNSEEN_PERFORMERS, Performer, act
from tests.conftest import SHARED_DATA
from tests.model.synthetic import sample_skin
from usdface.core.deformer import Deformer
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import Prediction, WeightPredictor
from usdface.model.mapping.regions import region_points
from usdface.model.mapping.train import train_mapping
from usdface.model.mapping.uncertainty import LIMIT_DEVIATIONS
from usdface.numerics.measure.face_regions import gaze_and_tongue_shapes
from usdface.numerics.regression.cross_validation import surface_errors_mm
from usdface.steps.inputs.cleaned_takes import read_markers_at, take_head_space
from usdface.usdio.mapping import read_mapping
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

COUNTS = (25, 50, 100)
NOISES = ("as recorded", "noise 0.5 mm", "noise 1 mm")
KEY_ERROR, INEXACT_COUNT = 0.12, 50
"""Standard deviation of the relative error of inexact keys, and the references that have them."""
KEYS = ("", ", inexact keys", ", inexact gains")


@dataclass(frozen=True)
class Claims:
    """Predicted and true errors of one take.

    Attributes
    ----------
    group, take : str
    count : int
        References.
    error_mm, limit_mm : (frames, regions) float arrays
        The whole face first.
    """

    group: str
    take: str
    count: int
    error_mm: np.ndarray
    limit_mm: np.ndarray

    @property
    def share_within(self) -> np.ndarray:
        """Return the share of frames within the limit, for each region."""
        shares: np.ndarray = (self.error_mm <= self.limit_mm).mean(axis=0)
        return shares


def run(counts: tuple[int, ...] = COUNTS, *, quick: bool = False) -> None:
    """Print the share of frames within the limit.

    `quick` runs one number of references.
    """
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    counts = (50,) if quick else counts
    print("share of frames whose error is within the uncertainty, wanted for nine in ten\n")
    print("| references | performer | take | face | parts | worst part | face: error, limit [mm] |")
    print("|---|---|---|---|---|---|---|")
    found = []
    for each in chain(_crosstake(counts), _performers(counts)):
        parts = each.share_within[1:]
        print(
            f"| {each.count} | {each.group} | {each.take} | {_percent(each.share_within[0])} | "
            f"{_percent(parts.mean())} | {_percent(parts.min())} | "
            f"{np.median(each.error_mm[:, 0]):.2f}, {np.median(each.limit_mm[:, 0]):.2f} |",
            flush=True,
        )
        found.append(each)
    _print_claims(found)


def _crosstake(counts: tuple[int, ...]) -> Iterator[Claims]:
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    rig = read_rig(rig_file)
    shapes = Deformer(rig).shapes
    gram, skin = shapes.gram(), sample_skin(shapes.target_offsets())
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    names = [str(name) for name in truth["shapes"]]
    for noise in NOISES:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            crosstake.prepare(folder, noise, truth)
            for count in counts:
                references = crosstake.choose_references(folder, rig_file, count)
                crosstake.map_take(references, rig_file, "auto")
                mapping = read_mapping(folder / "x.mapping.usdc")
                take = TakeReader(folder / "x.clean.take.usda")
                seen = read_markers_at(
                    take, range(take.first_frame + crosstake.HALF, take.last_frame + 1)
                )
                placed = take_head_space(take, face_of_mapping(mapping)).place(seen)
                said = WeightPredictor(mapping).predict(placed.positions, visible=placed.visible)
                wanted = truth["weights"][crosstake.HALF :].astype(float)
                own = [rig.shapes.index(shape) for shape in mapping.shape_names]
                error = errors_by_region(
                    said.weights - wanted[:, [names.index(s) for s in mapping.shape_names]],
                    said.regions,
                    mapping.shape_names,
                    gram[np.ix_(own, own)],
                    skin[own],
                )
                yield _claims("crosstake", noise, count, error, said)


def _performers(counts: tuple[int, ...]) -> Iterator[Claims]:
    for performer in (*PERFORMERS, *UNSEEN_PERFORMERS):
        for count, keys in product(counts, KEYS):
            if keys and (count != INEXACT_COUNT or performer in UNSEEN_PERFORMERS):
                continue
            acted = act(performer, count)
            shapes, weights = acted.shapes, acted.references.weights
            rng = np.random.default_rng(performer[1])
            errors = rng.standard_normal(weights[:, :1].shape if "gains" in keys else weights.shape)
            inexact = np.clip(weights * (1 + KEY_ERROR * errors), 0, 1)
            mapping = train_mapping(
                replace(acted.references, weights=inexact if keys else weights),
                ranges=np.tile([0.0, 1.0], (len(shapes.names), 1)),
                gram=shapes.gram,
                skin=shapes.skin,
            )
            for take, markers, truth in acted.takes:
                said = WeightPredictor(mapping).predict(markers)
                error = errors_by_region(
                    said.weights - truth, said.regions, shapes.names, shapes.gram, shapes.skin
                )
                group = f"{_name(performer)}{keys}"
                yield _claims(group, take, count, error, said)


def _name(performer: Performer) -> str:
    return f"{performer[0]}, {performer[1]}"


def _claims(group: str, take: str, count: int, error: np.ndarray, said: Prediction) -> Claims:
    return Claims(group, take, count, error, LIMIT_DEVIATIONS * said.uncertainty)


def errors_by_region(
    off: np.ndarray,
    regions: tuple[str, ...],
    names: tuple[str, ...],
    gram: np.ndarray,
    skin: np.ndarray,
) -> np.ndarray:
    """Return the error of the skin of each region, without gaze and tongue [mm]."""
    off = off.copy()
    off[:, gaze_and_tongue_shapes(names)] = 0.0
    errors = np.tile(surface_errors_mm(off, gram)[:, None], (1, len(regions)))
    for region, points in region_points(names, skin).items():
        if region in regions[1:]:
            moves = skin[:, points]
            own = np.einsum("spc,tpc->st", moves, moves, optimize=True) / len(points)
            errors[:, regions.index(region)] = surface_errors_mm(off, own)
    return errors


def _print_claims(found: list[Claims]) -> None:
    print("\n| measure | value | wanted |")
    print("|---|---|---|")
    for label, own in (
        ("crosstake", [each for each in found if each.group == "crosstake"]),
        ("performers", [each for each in found if each.group in map(_name, PERFORMERS)]),
        (
            "performers that chose nothing",
            [e for e in found if e.group in map(_name, UNSEEN_PERFORMERS)],
        ),
        ("performers, inexact keys or gains", [each for each in found if "inexact" in each.group]),
    ):
        for count in sorted({each.count for each in own}):
            shares = [each.share_within[0] for each in own if each.count == count]
            what = f"share within the uncertainty of the face, {label}, {count} references"
            print(f"| {what}: mean of takes | {_percent(np.mean(shares))} | ≥ 90 % |")
            print(f"| {what}: least of takes | {_percent(min(shares))} | ≥ 85 % |")


def _percent(share: float, digits: int = 0) -> str:
    return f"{100 * share:.{digits}f} %"
