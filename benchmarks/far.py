"""Accuracy and uncertainty near the references and far from them.

All references are from the first half of `crosstake`. Near: its second half. Far: the same
performer with the right side 20 s late (`onesided`: winks, half smiles), inexact keys, late keys,
keys of the largest shapes only, pairs of two animators with different gains, and brows with
references of the cheeks. Keys and takes are read from files, as a user would make them; methods are
trained and compared in memory.

Which references are selected is chance: takes that differ by 0.03 mm give others, which changes
errors by up to a fifth. Figures are means over four selections, from frames that begin three
seconds apart.

Frames are blocks of consecutive ones, evenly spread over the take, for the measurement of jitter;
`--full` uses all frames.
"""

import csv
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.stats import spearmanr

from benchmarks import crosstake
from benchmarks._damage import DAMAGES
from benchmarks._takes import markers_of, performer_of
from tests.conftest import SHARED_DATA
from tests.model.synthetic import align_markers, sample_skin
from usdface.core.assets import References, Rig, Take, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.model.mapping.predict import Prediction, WeightPredictor
from usdface.model.mapping.regions import skin_points
from usdface.model.mapping.train import train_mapping
from usdface.model.mapping.uncertainty import LIMIT_DEVIATIONS
from usdface.model.selection.baseline import set_up_equation
from usdface.numerics.measure.face_regions import points_by_region, region_gram
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.placement import rest_places
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

METHODS = ("face_map", "ridge", "kernel_cca")
RIG = SHARED_DATA / "rigs" / "facecap_head.usdc"
BLOCKS, BLOCK_FRAMES = 16, 60
REFERENCE_COUNTS = (50, 25)
FIRST_FRAMES = (1, 361, 721, 1081)
"""First frames of the range that references are selected from, for each selection."""
SEEDS = range(5)
KEY_ERROR, DROPPED_BELOW, DROPPED_SHARE = 0.15, 0.1, 1 / 3
"""Inexact keys: errors of 15 %, and a third of the keys below 0.1 set to 0."""

LATE_FRAMES = 2
"""Late keys: those of the expression two frames before, 33 ms."""

KEYED_SHAPES = (8, 12)
"""Fewest and most shapes that are keyed where only the largest of each expression are."""

TUNED_COUNTS = (4, 6, 8, 12, 25)

ANIMATOR_GAINS = (1.1, 0.9)
"""Gains of two animators, who key the even and the odd pairs."""


@dataclass(frozen=True)
class Setup:
    """References, frames to map, and their true weights.

    Attributes
    ----------
    markers, visible : (frames, markers, 3) and (frames, markers) arrays
        In the references' order and head space.
    truth : (frames, shapes) float array
    block : int
        Number of consecutive frames.
    """

    name: str
    references: References
    markers: np.ndarray
    visible: np.ndarray
    truth: np.ndarray
    block: int


@dataclass(frozen=True)
class Ruler:
    """Error measures on the surface and the regions of a rig."""

    rig: Rig
    deformer: Deformer
    gram: np.ndarray
    skin: np.ndarray
    rest: np.ndarray
    regions: dict[str, np.ndarray]

    @classmethod
    def of(cls, file: Path) -> "Ruler":
        rig = read_rig(file)
        deformer = Deformer(rig)
        offsets = sparse.csr_array(deformer.shapes.target_offsets())
        points = points_by_region(offsets, rig.shapes)
        regions = {name: region_gram(offsets, each) for name, each in points.items()}
        gram = deformer.shapes.gram()
        rest = deformer.neutral[skin_points(offsets)]
        return cls(rig, deformer, gram, sample_skin(offsets), rest, {"face": gram} | regions)

    def train(self, references: References, method: str) -> TrainedMapping:
        """Train with the defaults of `usdface train`."""
        columns = [self.rig.shapes.index(name) for name in references.shape_names]
        return train_mapping(
            references,
            ranges=self.rig.ranges[columns],
            gram=self.gram[np.ix_(columns, columns)],
            skin=self.skin[columns],
            rest=rest_places(references, self.rig, self.rest),
            method=method,
        )

    def errors_mm(self, error: np.ndarray, region: str = "face") -> np.ndarray:
        """Return the root mean square error of the surface in each frame [mm]."""
        squared = np.einsum("fs,st,ft->f", error, self.regions[region], error, optimize=True)
        return np.sqrt(np.maximum(squared, 0))


def run(methods: tuple[str, ...] = METHODS, *, full: bool = False) -> None:
    """Print errors of every method, and the uncertainty of the first."""
    if not (SHARED_DATA / "onesided").is_dir():
        print(f"skipped: no onesided in {SHARED_DATA}")
        return
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name))
        compare(Path(name), methods, full=full)


def compare(folder: Path, methods: tuple[str, ...], *, full: bool = False) -> None:
    """Print the tables of the takes that `prepare` wrote to a folder."""
    ruler = Ruler.of(RIG)
    draws = [list(read_setups(folder, first, full=full)) for first in FIRST_FRAMES]
    columns = list(zip(*draws, strict=True))
    print("means over selections: vertex RMS (smallest to largest) [mm], blink bias, jitter\n")
    print(f"| method | {' | '.join(each[0].name for each in columns)} |")
    print(f"|---|{'---|' * len(columns)}")
    solved = [[solve(each, ruler, methods[0]) for each in column] for column in columns]
    for method in methods:
        cells = []
        for column, predicted in zip(columns, solved, strict=True):
            found = predicted
            if method != methods[0]:
                found = [solve(each, ruler, method) for each in column]
            cells.append(mean_figures([each.weights for each in found], column, ruler))
        print(f"| {method} | {' | '.join(cells)} |", flush=True)
    solutions = [_bounded(each.markers, each.visible, each, ruler, folder) for each in draws[0]]
    cells = [
        mean_figures([each], column[:1], ruler)
        for each, column in zip(solutions, columns, strict=True)
    ]
    print(f"| bounded least squares | {' | '.join(cells)} |\n", flush=True)
    _print_uncertainty(methods[0], columns, solved, ruler)
    _print_partly_tuned(draws[0][0], ruler, folder)
    print(f"\n{methods[0]}: processor time per frame [ms], of all frames\n")
    print("| set-up | value | wanted |\n|---|---|---|")
    for each in islice(read_setups(folder, full=True), len(REFERENCE_COUNTS)):
        mapping, start = ruler.train(each.references, methods[0]), time.process_time()
        WeightPredictor(mapping).predict(each.markers, visible=each.visible)
        elapsed_ms = 1e3 * (time.process_time() - start)
        print(f"| {each.name} | {elapsed_ms / len(each.markers):.2f} | ≤ 0.15 |", flush=True)
    print("\nbrows through references of the cheeks: share of the baseline's motion\n")
    print("| method | value | wanted |\n|---|---|---|")
    for method in methods:
        print(f"| {method} | {brow_share(folder, ruler, method):.2f} | ≥ 0.8 |", flush=True)


def prepare(folder: Path) -> None:
    """Ingest, clean and select; existing files are kept."""
    for name in ("crosstake", "onesided"):
        if not (folder / name).is_dir():
            (folder / name).mkdir()
            truth = np.load(SHARED_DATA / name / "truth.npz")
            crosstake.prepare(folder / name, DAMAGES[0], truth, name)
    for count, first in product(REFERENCE_COUNTS, FIRST_FRAMES):
        out = references_file(folder, count, first)
        if not out.is_file():
            crosstake.choose_references(folder / "crosstake", RIG, count, first=first, out=out)
    for name in ("CheeksMoCap", "EyebrowsMoCap"):
        if not (folder / f"{name}.clean.take.usda").is_file():
            source = SHARED_DATA / "markers_animface" / f"{name}.c3d"
            take = folder / f"{name}.take.usda"
            execute(IngestSpec(sources=(source,), out=take))
            execute(CleanSpec(take=take, out=folder / f"{name}.clean.take.usda"))
    if not (folder / "cheeks.references.usda").is_file():
        cheeks = folder / "CheeksMoCap.clean.take.usda"
        out = folder / "cheeks.references.usda"
        execute(SelectSpec(takes=(cheeks,), rig=RIG, out=out, count=30))


def references_file(folder: Path, count: int, first_frame: int) -> Path:
    """Return the file of the references selected from frames that begin at one."""
    return folder / "crosstake" / f"{count}.{first_frame}.references.usda"


def read_setups(
    folder: Path, first_frame: int = FIRST_FRAMES[0], *, full: bool = False
) -> Iterator[Setup]:
    """Yield all setups of a selection."""
    near, far = (_read_take(folder / name) for name in ("crosstake", "onesided"))
    references = {
        count: read_references(references_file(folder, count, first_frame))
        for count in REFERENCE_COUNTS
    }
    second, whole = _blocks(crosstake.HALF, len(near[1]), full), _blocks(0, len(far[1]), full)
    for count, each in references.items():
        yield _setup(f"crosstake, {count}", each, near, second)
    fifty = references[50]
    yield _setup("one-sided", fifty, far, whole)
    for seed in SEEDS:
        keys = replace(fifty, weights=_inexact(fifty.weights, seed))
        yield _setup(f"inexact keys, {seed}", keys, near, second)
    gains = np.resize(ANIMATOR_GAINS, len(fifty.weights))[:, None]
    keys = replace(fifty, weights=np.clip(fifty.weights * gains, 0, 1))
    yield _setup("two animators", keys, near, second)
    late = near[1][fifty.frames - near[0].first_frame - LATE_FRAMES]
    late = late[:, [near[2].index(shape) for shape in fifty.shape_names]]
    yield _setup("late keys", replace(fifty, weights=late), near, second)
    keys_of_largest = replace(fifty, weights=_largest(fifty.weights))
    yield _setup("largest keys", keys_of_largest, near, second)
    authors = tuple(np.resize(("first", "second"), len(fifty.weights)).tolist())
    yield _setup("named animators", replace(keys, authors=authors), near, second)


def _inexact(weights: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    off = weights * (1 + KEY_ERROR * rng.standard_normal(weights.shape))
    off[(off < DROPPED_BELOW) & (rng.random(weights.shape) < DROPPED_SHARE)] = 0
    return np.clip(off, 0, 1)


def _largest(weights: np.ndarray) -> np.ndarray:
    counts = np.random.default_rng(0).integers(*KEYED_SHAPES, size=(len(weights), 1), endpoint=True)
    ranks = np.argsort(np.argsort(-weights, axis=1), axis=1)
    return np.where(ranks < counts, weights, 0)


def _read_take(folder: Path) -> tuple[Take, np.ndarray, tuple[str, ...]]:
    with (folder / "keys.csv").open(newline="") as stream:
        rows = csv.reader(stream)
        names = tuple(next(rows)[1:])
        keys = np.array([[float(each) for each in row[1:]] for row in rows])
    return read_take(folder / "x.clean.take.usda"), keys, names


def _blocks(first: int, last: int, full: bool) -> np.ndarray:
    if full:
        return np.arange(first, last)
    starts = np.linspace(first, last - BLOCK_FRAMES, BLOCKS).astype(int)
    return (starts[:, None] + np.arange(BLOCK_FRAMES)).ravel()


def _setup(
    name: str,
    references: References,
    take: tuple[Take, np.ndarray, tuple[str, ...]],
    rows: np.ndarray,
) -> Setup:
    markers = markers_of(take[0])
    columns = [take[2].index(shape) for shape in references.shape_names]
    some = replace(
        markers,
        positions=markers.positions[rows],
        visible=markers.visible[rows],
        confidence=markers.confidence[rows],
    )
    space = train_mapping(
        references, ranges=np.tile([0.0, 1.0], (len(columns), 1)), gram=None, method="ridge"
    )
    placed = align_markers(space, some, rate=float(take[0].rate))
    follow = len(rows) if len(rows) > BLOCKS * BLOCK_FRAMES else BLOCK_FRAMES
    return Setup(
        name, references, placed.positions, placed.visible, take[1][rows][:, columns], follow
    )


def solve(setup: Setup, ruler: Ruler, method: str) -> Prediction:
    """Train and map."""
    mapping = ruler.train(setup.references, method)
    return WeightPredictor(mapping).predict(setup.markers, visible=setup.visible)


def mean_figures(solved: Sequence[np.ndarray], setups: Sequence[Setup], ruler: Ruler) -> str:
    """Return the mean of `figures` over selections as a cell."""
    each = np.array([figures(*pair, ruler) for pair in zip(solved, setups, strict=True)])
    rms, bias, jitter = each.mean(axis=0)
    spread = f" ({each[:, 0].min():.3f} to {each[:, 0].max():.3f})" if len(each) > 1 else ""
    return f"{rms:.3f}{spread}, {bias:+.3f}, {jitter:.2f}"


def figures(weights: np.ndarray, setup: Setup, ruler: Ruler) -> tuple[float, float, float]:
    """Return error, blink bias and jitter by the fixtures' measures."""
    error = on_rig(weights - setup.truth, setup, ruler)
    blinks = [
        i for i, n in enumerate(setup.references.shape_names) if n.lower().startswith("eyebl")
    ]
    lids = setup.truth[:, blinks]
    bias = (weights - setup.truth)[:, blinks][lids > np.quantile(lids, 0.97, axis=0)].mean()
    rough = [
        np.abs(np.diff(each.reshape(-1, setup.block, each.shape[1]), 3, axis=1)).mean()
        for each in (weights, setup.truth)
    ]
    return float(np.sqrt((ruler.errors_mm(error) ** 2).mean())), bias, rough[0] / rough[1]


def on_rig(values: np.ndarray, setup: Setup, ruler: Ruler) -> np.ndarray:
    """Return values in the order of the rig's shapes."""
    out = np.zeros((len(values), len(ruler.rig.shapes)))
    out[:, [ruler.rig.shapes.index(name) for name in setup.references.shape_names]] = values
    return out


def _bounded(
    markers: np.ndarray, visible: np.ndarray, setup: Setup, ruler: Ruler, folder: Path
) -> np.ndarray:
    """Solve the blendshape equation, which needs no references."""
    performer = performer_of(_read_take(folder / "crosstake")[0])
    neutral = setup.references.neutral.astype(float)
    equation = set_up_equation(ruler.rig, ruler.deformer, replace(performer, neutral=neutral))
    weights = equation.propose(markers.astype(float), visible=visible)
    return weights[:, [ruler.rig.shapes.index(name) for name in setup.references.shape_names]]


def _print_partly_tuned(setup: Setup, ruler: Ruler, folder: Path) -> None:
    """Print errors where only the first pairs, in the order of `select`, are tuned."""
    references = setup.references
    every = np.ones(references.markers.shape[:2], dtype=bool)
    proposals = _bounded(references.markers, every, setup, ruler, folder)
    print("\nfirst pairs tuned, the others proposals: vertex RMS [mm], blink bias, jitter\n")
    print("| tuned | trained on all pairs | on the tuned ones |\n|---|---|---|")
    for count in TUNED_COUNTS:
        tuned = np.arange(len(references.weights)) < count
        weights = np.where(tuned[:, None], references.weights, proposals)
        some = [
            replace(setup, references=each)
            for each in (replace(references, weights=weights), references.rows(tuned))
        ]
        cells = [
            mean_figures([solve(each, ruler, METHODS[0]).weights], [each], ruler) for each in some
        ]
        print(f"| {count} | {' | '.join(cells)} |", flush=True)


def _print_uncertainty(
    method: str,
    columns: Sequence[Sequence[Setup]],
    solved: Sequence[Sequence[Prediction]],
    ruler: Ruler,
) -> None:
    """Print the rank correlation of uncertainty and error, and how often the 90 % limit holds."""
    regions = solved[0][0].regions
    print(f"{method}: medians of error and uncertainty of the face [mm]")
    print("Spearman of uncertainty and error; share of frames within nine in ten\n")
    print(f"| set-up | error | uncertainty | {' | '.join(regions)} |")
    print(f"|---|---|---|{'---|' * len(regions)}")
    for setups, predicted in zip(columns, solved, strict=True):
        rows = []
        for setup, each in zip(setups, predicted, strict=True):
            error = on_rig(each.weights - setup.truth, setup, ruler)
            row = [np.median(ruler.errors_mm(error)), np.median(each.uncertainty[:, 0])]
            for region, limit in zip(regions, LIMIT_DEVIATIONS * each.uncertainty.T, strict=True):
                true = ruler.errors_mm(error, region)
                row += [spearmanr(limit, true)[0], (true <= limit).mean()]
            rows.append(row)
        mean = np.mean(rows, axis=0)
        cells = [f"{median:.2f}" for median in mean[:2]]
        cells += [f"{rank:.2f}, {share:.0%}" for rank, share in mean[2:].reshape(-1, 2)]
        print(f"| {setups[0].name} | {' | '.join(cells)} |", flush=True)


def brow_share(folder: Path, ruler: Ruler, method: str) -> float:
    """Map a recorded take of the brows with references of the cheeks.

    Keys are the baseline's proposals, so that a mapping without error gives the baseline.
    """
    references = read_references(folder / "cheeks.references.usda")
    cheeks_take, brows_take = (
        read_take(folder / f"{name}.clean.take.usda") for name in ("CheeksMoCap", "EyebrowsMoCap")
    )
    columns = [ruler.rig.shapes.index(name) for name in references.shape_names]
    mapping = ruler.train(references, method)
    placed = align_markers(mapping, markers_of(brows_take), rate=float(brows_take.rate))
    rows = slice(None, None, 3)
    performer = replace(performer_of(cheeks_take), neutral=references.neutral.astype(float))
    equation = set_up_equation(ruler.rig, ruler.deformer, performer)
    baseline = equation.propose(placed.positions[rows].astype(float), visible=placed.visible[rows])[
        :, columns
    ]
    solved = (
        WeightPredictor(mapping)
        .predict(placed.positions[rows], visible=placed.visible[rows])
        .weights
    )
    moving = [i for i, name in enumerate(references.shape_names) if name.lower().startswith("brow")]
    spread = [np.sqrt(each[:, moving].var(axis=0).sum()) for each in (solved, baseline)]
    return float(spread[0] / spread[1])
