"""Raw captures drawn at random, from the C3D file to weights, with the commands of a user.

Performers, marker sets, head bands, head motion, gaps, swapped labels, outliers, units, keys and
performances are drawn from wide ranges. The seed of a set-up is its number. The tested take is
captured separately from that of the references; markers may have been applied again, and a band may
slip. Errors are those of the skin without gaze and tongue, against the weights of the simulation.
"""

import tempfile
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from pxr import Usd
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks._takes import channel_of
from benchmarks.confidence import errors_by_region
from benchmarks.performers import Shapes, performance
from tests.c3d_write import write_c3d
from tests.conftest import SHARED_DATA
from usdface.cli import main
from usdface.core.deformer import Deformer
from usdface.model.mapping.regions import skin_points
from usdface.model.mapping.uncertainty import LIMIT_DEVIATIONS
from usdface.usdio.rig.read import read_rig

SETUPS, QUICK_SETUPS = 16, 2
SECONDS, TESTED_SECONDS, REST_SECONDS = 40, 20, 1
BAND_SIZE = {"none": 0, "three": 3, "band": 6, "slipping": 6}
HEAD_MOTION = {"still": (1, 2), "nod": (8, 15), "walk": (6, 400), "turn": (25, 60)}
"""Standard deviations of the head's rotation [degrees] and translation [mm]."""
SLIP_MM, SLIP_SECONDS = 2.0, 8.0
"""Standard deviation of a slipping band's translation, and its period."""
FRONT_MM = 3.0
"""Points less than this behind another that covers them are on the outside of the face."""


@dataclass(frozen=True)
class Setup:
    """What is drawn for a set-up."""

    rig: str
    markers: int
    lids: int
    band: str
    noise_mm: float
    swaps: int
    gaps: int
    """Long gaps, of one to four seconds."""
    lost: int
    """Markers that fall off within the take."""
    outliers: int
    motion: str
    named: bool
    """Whether labels name parts of the face."""
    pairs: int
    key_error: float
    tested: str
    reapplied_mm: float
    rate: int
    metres: bool
    skin_mm: float
    gain_deviation: float
    size: float

    def __str__(self) -> str:
        return (
            f"{self.markers} markers, {self.lids} on lids, head band {self.band}, {self.motion}, "
            f"noise {self.noise_mm}, {self.pairs} pairs, reapplied {self.reapplied_mm} mm"
        )


def run(*, quick: bool = False) -> None:
    """Print errors and shares within the uncertainty; `quick` runs the first set-ups."""
    if not (SHARED_DATA / "rigs").is_dir():
        print(f"skipped: no rigs in {SHARED_DATA}")
        return
    print("vertex RMS [mm] of the take of the references and of another; frames within the limit")
    print("\n| set-up | references' | another | baseline | face | worst region | verdict |")
    print("|---|---|---|---|---|---|---|")
    errors, shares = [], []
    for number in range(QUICK_SETUPS if quick else SETUPS):
        setup, found = measure(number)
        if isinstance(found, str):
            print(f"| {number}: {setup} | refused: {found} | | | | | |", flush=True)
            continue
        own, other, baseline, within, verdict = found
        errors.append((own, other, baseline))
        shares.append(within)
        print(
            f"| {number}: {setup} | {own:.2f} | {other:.2f} | {baseline:.2f} | "
            f"{100 * within[0]:.0f} % | {100 * min(within[1:]):.0f} % | {verdict} |",
            flush=True,
        )
    means = np.exp(np.log(errors).mean(axis=0))
    share = np.array([(each[0], min(each[1:])) for each in shares])
    print("\n| measure | value |\n|---|---|")
    for name, mean in zip(("references' take", "another take", "baseline"), means, strict=True):
        print(f"| error, {name}, geometric mean | {mean:.2f} |")
    print(f"| set-ups with a larger error than the baseline | {_worse(errors)} of {len(errors)} |")
    print(f"| face, mean share within the limit | {100 * share[:, 0].mean():.0f} % |")
    print(f"| set-ups with a region below 80 % | {(share[:, 1] < 0.8).sum()} of {len(share)} |")


def _worse(errors: list[tuple[float, float, float]]) -> int:
    return sum(other > baseline for _, other, baseline in errors)


Found = tuple[float, float, float, list[float], str]


def measure(number: int) -> tuple[Setup, Found | str]:
    """Return a set-up, and its errors, shares and verdict, or the message of a refusal."""
    rng = np.random.default_rng(7000 + number)
    setup = draw_setup(rng)
    file = SHARED_DATA / "rigs" / f"{setup.rig}.usdc"
    shapes, weights = rig_shapes(file), performances(file, setup)
    performer = Performer(shapes, setup, rng)
    with tempfile.TemporaryDirectory() as name, chdir(name):
        for take, acted in zip("ab", weights, strict=True):
            shift = setup.reapplied_mm * (take == "b")
            performer.capture(Path(f"{take}.c3d"), acted, shift, rng)
        error = 1 + setup.key_error * rng.standard_normal(weights[0].shape)
        write_keys(Path("keys.csv"), read_rig(file).shapes, np.clip(weights[0] * error, 0, 1))
        units = "--units m" if setup.metres else ""
        lines = [
            step
            for take in "ab"
            for step in (
                f"ingest {take}.c3d --out {take}.take.usda --neutral 3 --performer p "
                f"--session {'a' if not setup.reapplied_mm else take} {units}",
                f"clean {take}.take.usda --out {take}.clean.take.usda",
            )
        ]
        mapped = "--mapping m.usdc", "--mapping m.usdc", "--baseline"
        lines += [
            f"select a.clean.take.usda --rig {file} --count {setup.pairs} --out r.usda",
            "references import r.usda --weights keys.csv",
            "train r.usda --out m.usdc",
            *(
                f"map {take}.clean.take.usda --rig {file} {option} --out {out}.usda"
                for take, option, out in zip("abb", mapped, ("own", "other", "base"), strict=True)
            ),
        ]
        for line in lines:
            code, said = run_command(line)
            if code:
                return setup, said.strip().splitlines()[-1][:120]
            if "own.usda" in line or "other.usda" in line:
                verdict = said.strip().splitlines()[-1].partition(":")[0]
        (own, _), (other, within), (base, _) = (
            score(Path(f"{out}.usda"), acted, shapes)
            for out, acted in zip(("own", "other", "base"), (*weights, weights[1]), strict=True)
        )
    return setup, (own, other, base, within, verdict)


def run_command(line: str) -> tuple[int, str]:
    output = StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        try:
            main(line.split())
        except SystemExit as end:
            return int(end.code or 0), output.getvalue()
    return 0, output.getvalue()


def draw_setup(rng: np.random.Generator) -> Setup:
    choice = rng.choice
    return Setup(
        rig=str(choice(["ict_face", "facecap_head"])),
        markers=int(choice([35, 55, 80, 110])),
        lids=int(choice([0, 1, 2, 2])),
        band=str(choice(["none", "three", "band", "slipping"])),
        noise_mm=float(choice([0.05, 0.1, 0.2, 0.4])),
        swaps=int(choice([0, 0, 3, 10])),
        gaps=int(choice([0, 0, 8])),
        lost=int(choice([0, 0, 1, 4])),
        outliers=int(choice([0, 5, 50])),
        motion=str(choice(list(HEAD_MOTION))),
        named=bool(rng.random() < 0.5),
        pairs=int(choice([12, 25, 50])),
        key_error=float(choice([0, 0.05, 0.12])),
        tested=str(choice(["second half", "another"])),
        reapplied_mm=float(choice([0, 0, 1])),
        rate=int(choice([30, 60, 120])),
        metres=bool(rng.random() < 0.3),
        skin_mm=float(choice([20, 60])),
        gain_deviation=float(choice([0.1, 0.25])),
        size=float(choice([1, 1, 0.75])),
    )


def channel_columns(names: tuple[str, ...], channels: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return the columns of a rig's shapes and of the channels of a phone that drive them."""
    own = [channel_of(name) for name in names]
    bare = [each.removesuffix("left").removesuffix("right") for each in own]
    return [
        (column, channels.index(name))
        for column, pair in enumerate(zip(own, bare, strict=True))
        for name in pair[: 1 + (pair[1] not in own)]
        if name in channels
    ]


def performances(file: Path, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """Return weights of the rig's shapes in both takes, which start at rest."""
    names = read_rig(file).shapes
    found = []
    for source, rate in (
        ("livelink_alex/alex_rom_3.csv", 30),
        ("livelink_jmtechart/MySlate_3_Jason_Millers_iPhone.csv", 60),
    ):
        values, channels = performance(source, rate)
        weights = np.zeros((len(values), len(names)))
        for column, channel in channel_columns(names, channels):
            weights[:, column] = values[:, channel]
        found.append(weights)
    half = len(found[0]) // 2
    tested = found[0][half:] if setup.tested == "second half" else found[1]
    pair = []
    for acted, seconds in ((found[0][:half], SECONDS), (tested, TESTED_SECONDS)):
        middle = acted[max(0, (len(acted) - 60 * seconds) // 2) :][: 60 * seconds]
        times = np.arange(int(len(middle) / 60 * setup.rate)) / setup.rate * 60
        own = np.stack([np.interp(times, np.arange(len(middle)), c) for c in middle.T], axis=1)
        rest = REST_SECONDS * setup.rate
        rise = np.clip(np.arange(rest) / rest * 2 - 1, 0, 1)[:, None]
        pair.append(np.vstack([rise * own[0], own]))
    return pair[0], pair[1]


def rig_shapes(file: Path) -> Shapes:
    """Return displacements by the rig's own shapes, of all points."""
    rig = read_rig(file)
    deformer = Deformer(rig)
    flat = deformer.shapes.target_offsets().toarray()
    names = tuple(channel_of(each) for each in rig.shapes)
    gram = flat @ flat.T / len(deformer.neutral)
    return Shapes(names, deformer.neutral, flat.reshape(len(flat), -1, 3), gram)


class Performer:
    """A simulated performer with markers."""

    def __init__(self, shapes: Shapes, setup: Setup, rng: np.random.Generator) -> None:
        self._setup = setup
        chosen = _place_markers(shapes, setup, rng)
        count, motion = len(shapes.names), shapes.skin[:, chosen]
        proportions = rng.uniform(0.88, 1.12, 3) * setup.size
        gain = np.exp(setup.gain_deviation * rng.standard_normal((count, 1, 1)))
        turn = Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))).as_matrix()
        local = 1 + 0.1 * rng.standard_normal((len(chosen), 1))
        self._basis = np.einsum("smc,sdc->smd", motion, turn) * gain * local * proportions
        self._face = shapes.places[chosen] * proportions + 1.5 * rng.standard_normal(
            (len(chosen), 3)
        )
        at = np.linspace(-1.2, 1.2, BAND_SIZE[setup.band])
        top, front = shapes.places[chosen].max(axis=0)[1:]
        band = [80 * np.sin(at), top + 25 + 5 * np.cos(3 * at), front - 95 + 80 * np.cos(at)]
        self._band = np.stack(band, axis=1) * proportions
        self._names = _labels(shapes, chosen, setup) + [f"head_{k}" for k in range(len(at))]
        if not setup.named:
            self._names = [f"m{k:03d}" for k in range(len(self._names))]
        self._shift = rng.standard_normal(self._face.shape)
        self._pivot = self._face.mean(axis=0) - [0, 90, 40]

    def capture(
        self, file: Path, weights: np.ndarray, shift_mm: float, rng: np.random.Generator
    ) -> None:
        """Write a C3D file; markers are applied `shift_mm` from where they were."""
        setup, frames = self._setup, len(weights)
        moved = np.einsum("fs,smc->fmc", weights, self._basis, optimize=True)
        far = np.linalg.norm(moved, axis=2, keepdims=True)
        moved *= setup.skin_mm * np.tanh(far / setup.skin_mm) / np.maximum(far, 1e-9)
        band = np.repeat(self._band[None], frames, axis=0)
        if setup.band == "slipping":
            slip = SLIP_MM * _smooth(frames, setup.rate, SLIP_SECONDS, rng)
            band += (slip - slip[0])[:, None]
        points = np.concatenate([self._face + shift_mm * self._shift + moved, band], axis=1)
        degrees, travel = HEAD_MOTION[setup.motion]
        angles = degrees * np.clip(_smooth(frames, setup.rate, 1.2, rng), -2.5, 2.5)
        turns = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        points = np.einsum("fij,fmj->fmi", turns, points - self._pivot) + self._pivot
        points += (travel * _smooth(frames, setup.rate, 2.0, rng))[:, None] + [100, 1500, -200]
        points += setup.noise_mm * rng.standard_normal(points.shape)
        visible = self._damage(points, rng)
        factor = 1e-3 if setup.metres else 1.0
        write_c3d(file, factor * points, visible, self._names, rate=setup.rate)

    def _damage(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Swap labels and add outliers, in place; return which points are visible."""
        setup, rest = self._setup, REST_SECONDS * self._setup.rate
        frames, count = points.shape[:2]
        visible = rng.random((frames, count)) > 0.001
        for low, high, times in ((0.05, 0.3, 40), (1, 4, setup.gaps)):
            for _ in range(times):
                length, start = int(setup.rate * rng.uniform(low, high)), rng.integers(rest, frames)
                visible[start : start + length, rng.integers(count)] = False
        for marker in rng.permutation(len(self._face))[: setup.lost]:
            visible[rng.integers(rest, frames) :, marker] = False
        near = np.asarray(KDTree(self._face).query(self._face, k=3)[1])
        for _ in range(setup.swaps):
            one = int(rng.integers(len(self._face)))
            both = [one, int(near[one, rng.integers(1, 3)])]
            start = rng.integers(rest, frames)
            stop = start + int(setup.rate * rng.uniform(0.3, 2))
            points[start:stop, both] = points[start:stop, both[::-1]]
        at = rng.integers(rest, frames, setup.outliers), rng.integers(count, size=setup.outliers)
        points[at] += 15 * rng.standard_normal((setup.outliers, 3))
        visible[: rest // 3] = True
        return visible


def _smooth(frames: int, rate: int, period: float, rng: np.random.Generator) -> np.ndarray:
    """Return a smooth random motion, (frames, 3), with a new value every period [s]."""
    times = np.arange(frames) / rate / period
    knots = int(times[-1]) + 4
    return CubicSpline(np.arange(knots), rng.standard_normal((knots, 3)))(times)


def _place_markers(shapes: Shapes, setup: Setup, rng: np.random.Generator) -> list[int]:
    """Return the points with a marker: spread over the front of the face, and on lids."""
    reach = np.linalg.norm(shapes.skin, axis=2)
    known = [not name.startswith(("eyelook", "tongue")) for name in shapes.names]
    largest = reach[known].max(axis=0)
    skin = skin_points(shapes.skin.reshape(len(shapes.skin), -1))
    depth, around = shapes.places[:, 2], KDTree(shapes.places[:, :2])
    outer = np.array(
        [
            i
            for i in skin
            if depth[around.query_ball_point(shapes.places[i, :2], 3)].max() < depth[i] + FRONT_MM
        ]
    )
    outer = outer[(largest[outer] > 1.2) & (depth[outer] > np.quantile(depth[outer], 0.25))]
    lids = [reach[shapes.names.index(f"eyeblink{side}")] for side in ("left", "right")]
    chosen = [int(outer[row[outer].argmax()]) for row in lids[: setup.lids]]
    pool = outer[np.all([row[outer] < 0.35 * row.max() for row in lids], axis=0)]
    far = np.full(len(pool), np.inf)
    while len(chosen) < setup.markers:
        if chosen:
            far = np.minimum(
                far, np.linalg.norm(shapes.places[pool] - shapes.places[chosen[-1]], axis=1)
            )
        chosen.append(int(pool[(np.minimum(far, 1e6) * rng.uniform(0.6, 1, len(pool))).argmax()]))
    return chosen


def _labels(shapes: Shapes, chosen: list[int], setup: Setup) -> list[str]:
    """Return labels that name a part of the face by the shape that moves the marker most."""
    reach = np.linalg.norm(shapes.skin[:, chosen], axis=2)
    reach[[name.startswith(("eyelook", "tongue")) for name in shapes.names]] = 0
    share = reach / np.linalg.norm(shapes.skin, axis=2).max(axis=1)[:, None]
    parts = {"brow": "brow", "eye": "lid", "jaw": "jaw", "nose": "nose", "cheek": "cheek"}
    names = []
    for number, best in enumerate(share.argmax(axis=0)):
        part = next((parts[p] for p in parts if shapes.names[best].startswith(p)), "lip")
        x = shapes.places[chosen[number], 0]
        names.append(f"{part}_{'L' if x > 1.5 else 'R' if x < -1.5 else 'M'}{number}")
    return names


def write_keys(file: Path, names: tuple[str, ...], weights: np.ndarray) -> None:
    rows = [",".join(("frame", *names))]
    rows += [f"{row + 1}," + ",".join(f"{w:.5f}" for w in each) for row, each in enumerate(weights)]
    file.write_text("\n".join(rows), encoding="utf-8")


def score(file: Path, truth: np.ndarray, shapes: Shapes) -> tuple[float, list[float]]:
    """Return the error [mm], and the shares of frames within the limit, the face first."""
    stage = Usd.Stage.Open(str(file))
    (animation,) = (each for each in stage.TraverseAll() if each.GetTypeName() == "SkelAnimation")
    samples = animation.GetAttribute("blendShapeWeights")
    frames = samples.GetTimeSamples()
    values = np.array([samples.Get(frame) for frame in frames])
    order = [channel_of(name) for name in animation.GetAttribute("blendShapes").Get()]
    solved = values[:, [order.index(name) for name in shapes.names]]
    difference = solved - truth[np.array(frames, int) - 1]
    named = animation.GetAttribute("face:residual:regions").Get()  # None of the baseline
    regions = ("face",) if named is None else tuple(map(str, named))
    skin = shapes.skin[:, skin_points(shapes.skin.reshape(len(shapes.skin), -1))]
    errors = errors_by_region(difference, regions, shapes.names, shapes.gram, skin)
    limit = np.full(errors.shape, np.inf)
    if named is not None:
        uncertainty = animation.GetAttribute("face:uncertainty")
        limit = LIMIT_DEVIATIONS * np.array([uncertainty.Get(frame) for frame in frames])
    return float(np.sqrt((errors[:, 0] ** 2).mean())), list((errors <= limit).mean(axis=0))
