"""Any mesh moved by markers, on set-ups drawn at random, with the commands of a user.

Faces, faults of their meshes, markers, performers and performances are drawn from wide ranges. The
seed of a set-up is its number; no setting was chosen on them. Errors are those of outer skin that
moves and has no marker, against the rig whose motion the markers have. Other methods have the same
markers, as `usdface bind` bound them.
"""

import tempfile
from contextlib import chdir
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, Vt
from scipy import sparse
from scipy.interpolate import RBFInterpolator
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks._random_meshes import FRAMES, Face, make_face
from benchmarks.random_captures import run_command
from tests.conftest import SHARED_DATA
from usdface.core.arrays import equal_rows
from usdface.core.assets import Markers, RigMesh, Take
from usdface.core.provenance import Provenance
from usdface.numerics.registration.marker_binding import fit_proportions
from usdface.numerics.surface.surface_graph import surface_graph
from usdface.usdio.rig.mesh import read_face_mesh
from usdface.usdio.surface.binding import read_binding
from usdface.usdio.take.write import write_take

SETUPS, QUICK_SETUPS = 12, 3
DRAWN: dict[str, tuple[Any, ...]] = {
    "face": ("actor", "character", "ict_face", "facecap_head", "ict_head"),
    "fault": ("no", "no", "triangles", "slivers", "holes", "fins", "copies", "seam", "soup"),
    "markers": (8, 14, 25, 42, 42, 70, 102, 150),
    "even": (True, True, False),
    "mouth": (0, 0, 0.4),
    "height_mm": (0, 2, 5),
    "twice": (False, False, False, True),
    "hidden": (0, 0, 0.15),
    "unlike": (0, 0.05, 0.1),
    "landmarks": (150, 150, 8),
    "acted": ("recorded", "bursts", "jaw", "winks"),
    "noise_mm": (0.1, 0.1, 0.3, 0.6),
    "head_degrees": (0, 0, 0.5),
    "metres": (False, False, True),
}
"""Choices of each property: face and fault of the mesh; number of markers, whether they are evenly
spaced, the share around the mouth, their height above the skin, whether two are at one place, the
share that half of the take hides; deviation of the logarithm of the performer's proportions; most
landmarks that a user names; performance, noise, head motion left in, unit and axis."""

METHODS = ("inverse distance", "harmonic", "biharmonic", "thin plate")
"""Shepard's with power 3; along edges; radial functions `r` and `r^2 log r` with a linear part."""

REGIONS = ("moving", "near", "far", "lips", "lids", "still")
NEAR_MM, FAR_MM, MOVING_MM, STILL_MM, NORMAL_90 = 8.0, 20.0, 0.5, 0.05, 1.645


def run(*, quick: bool = False) -> None:
    """Print errors and shares within the uncertainty; `quick` runs the first set-ups."""
    if not (SHARED_DATA / "rigs").is_dir():
        print(f"skipped: no rigs in {SHARED_DATA}")
        return
    names = ("default", *METHODS)
    print(
        "RMS error of moving skin [mm]; the lips' opening over the true one; within 90 % limits\n"
    )
    print(f"| set-up | {' | '.join(names)} | opening | all | largest quarter |")
    print("|---|" + "---|" * (len(names) + 3))
    every = []
    for number in range(QUICK_SETUPS if quick else SETUPS):
        setup, scores = measure(number)
        every.append(scores)
        words = " ".join(f"{name}={value}" for name, value in vars(setup).items())
        cells = [f"{each:.2f}" for each in scores[:-3, 0]]
        cells += [f"{100 * each:.0f} %" for each in scores[-3:, 0]]
        print(f"| {number}: {words} | {' | '.join(cells)} |", flush=True)
    print(f"\n| region | {' | '.join(names)} | within 90 % limits | in the largest quarter |")
    print("|---|" + "---|" * (len(names) + 2))
    table = np.array(every)
    for column, region in enumerate(REGIONS):
        mean = np.exp(np.nanmean(np.log(np.maximum(table[:, :-3, column], 1e-3)), axis=0))
        shares = 100 * np.nanmean(table[:, -2:, column], axis=0)
        cells = [f"{each:.2f}" for each in mean] + [f"{each:.0f} %" for each in shares]
        print(f"| {region} | {' | '.join(cells)} |")
    ratio = table[:, 0, 0] / table[:, 1:-3, 0].min(axis=1)
    print("\n| measure | value | wanted |\n|---|---|---|")
    print(
        f"| set-ups worse than the best of the others by over 2 % | {(ratio > 1.02).sum()} | ≤ 0 |"
    )
    print(f"| error over the least of the others | {np.exp(np.log(ratio).mean()):.2f} | ≤ 1 |")
    for name, share in zip(("all", "largest quarter"), table[:, -2:, 0].T, strict=True):
        print(f"| within 90 % limits, {name} | {100 * np.nanmean(share):.0f} % | ≥ 90 % |")
    print(f"| opening of the lips, median | {100 * np.nanmedian(table[:, -3, 0]):.0f} % | |")


def choose_markers(setup: SimpleNamespace, face: Face, rng: np.random.Generator) -> np.ndarray:
    """Return the points of the face with markers."""
    size = np.linalg.norm(face.motion, axis=2).max(axis=0)
    used = np.unique(np.concatenate([each for each in face.polygons if len(each) > 2]))
    used = used[face.outer[used] & (size[used] > 0.02 * size[face.outer].max())]
    around = KDTree(face.points[face.lip != 0]).query(face.points[used])[0] < 15
    chosen: list[int] = []
    for pool, count in ((used[around], int(setup.mouth * setup.markers)), (used, setup.markers)):
        while len(chosen) < count:
            spread = setup.even and len(chosen)
            away = None
            if spread:
                away = np.asarray(KDTree(face.points[chosen]).query(face.points[pool])[0])
            chosen.append(int(rng.choice(pool) if away is None else pool[away.argmax()]))
    if setup.twice:
        chosen[-1] = chosen[-2]
    return np.array(chosen)


def write_capture(
    setup: SimpleNamespace, face: Face, chosen: np.ndarray, rng: np.random.Generator
) -> Markers:
    """Write take.usda and face.usda; return the markers of a performer with other proportions."""
    height = setup.height_mm * rng.random((len(chosen), 1)) * [0, 0, 1]
    moved = face.points[chosen] + height + face.motion[:, chosen]
    moved *= np.exp(setup.unlike * rng.standard_normal(3))
    head = Rotation.from_rotvec(np.radians(setup.head_degrees) * rng.standard_normal((FRAMES, 3)))
    turns = Rotation.from_euler("y", rng.uniform(-20, 20), degrees=True) * head
    moved = np.einsum("fij,fmj->fmi", turns.as_matrix(), moved)
    moved += setup.noise_mm * rng.standard_normal(moved.shape)
    seen = np.ones(moved.shape[:2], bool)
    seen[FRAMES // 2 :, rng.random(len(chosen)) < setup.hidden] = False
    markers = Markers(
        names=tuple(f"m{i}" for i in range(len(chosen))),
        positions=np.where(seen[..., None], moved, moved[:1]).astype(np.float32),
        visible=seen,
        confidence=seen.astype(np.float32),
        space="stabilized",
    )
    take = Take(name="take", rate=Fraction(60), first_frame=0, markers=markers)
    write_take(Path("take.usda"), take, provenance=Provenance())
    stage = Usd.Stage.CreateNew("face.usda")
    UsdGeom.SetStageUpAxis(stage, "Z" if setup.metres else "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0 if setup.metres else 0.01)
    at = face.points * 0.1
    if setup.metres:
        at = np.stack([at[:, 0], -at[:, 2], at[:, 1]], axis=1) * 0.01
    mesh = UsdGeom.Mesh.Define(stage, "/face")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(at.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([len(each) for each in face.polygons])
    mesh.CreateFaceVertexIndicesAttr(np.concatenate(face.polygons).tolist())
    stage.Save()
    return markers


def measure(number: int) -> tuple[SimpleNamespace, np.ndarray]:
    """Return a set-up, and errors [mm] of each method, opening, and shares within: (8, regions)."""
    rng = np.random.default_rng(11_000 + number)
    drawn = {name: values[rng.integers(len(values))] for name, values in DRAWN.items()}
    setup = SimpleNamespace(**drawn)
    face = make_face(setup, rng)
    chosen = choose_markers(setup, face, rng)
    with tempfile.TemporaryDirectory() as name, chdir(name):
        markers = write_capture(setup, face, chosen, rng)
        named = rng.permutation(len(chosen))[: setup.landmarks]
        landmarks = ",".join(f"m{i}={chosen[i]}" for i in named)
        for line in (
            f"bind take.usda face.usda --out b.usda --landmarks {landmarks}",
            "deform take.usda --mesh face.usda --binding b.usda --out out.usda",
        ):
            code, said = run_command(line)
            if code:
                raise RuntimeError(f"{setup}: {said}")
        mesh = read_face_mesh(Path("face.usda"))
        binding = read_binding(Path("b.usda"), mesh).binding
        stage = Usd.Stage.Open("out.usda")
        prim = stage.GetPrimAtPath(mesh.path)
        moved, sd = (
            np.array([np.array(prim.GetAttribute(each).Get(t), float) for t in range(FRAMES)])
            for each in ("points", "primvars:face:uncertainty")
        )
    found = [(moved - mesh.local) @ mesh.linear.T, *(np.zeros_like(moved) for _ in METHODS)]
    order = [markers.names.index(each) for each in binding.names]
    places, positions = binding.places.positions(mesh.mesh.points), markers.positions[:, order]
    linear = fit_proportions(positions[0], places, weight=binding.confidence).linear
    shifts, seen = (positions - positions[0]) @ linear.T, markers.visible[:, order]
    for rows in equal_rows(seen):
        some = seen[rows[0]]
        for out, by in zip(found[1:], _operators(places[some], mesh.mesh), strict=True):
            out[rows] = np.einsum("pm,fmc->fpc", by, shifts[np.ix_(rows, some)], optimize=True)
    return setup, _scores(face, places, found, sd)


def _operators(places: np.ndarray, mesh: RigMesh) -> list[np.ndarray]:
    """Return maps from the motion of markers to that of points, (points, markers), of `METHODS`."""
    points, one = mesh.points, np.eye(len(places))
    near = np.maximum(np.linalg.norm(points[:, None] - places, axis=2), 1e-3) ** -3.0
    lengths = surface_graph(points, mesh.face_counts, mesh.face_indices, diagonals=False)[0]
    lengths.data = np.minimum(1.0 / lengths.data, 1e3)
    laplacian: Any = sparse.csgraph.laplacian(lengths)
    fixed = np.zeros((len(points), len(places)))
    fixed[KDTree(points).query(places)[1], np.arange(len(places))] = 1e6
    system = laplacian + sparse.diags_array(fixed.sum(axis=1) + 1e-9)
    return [
        near / near.sum(axis=1, keepdims=True),
        splu(sparse.csc_array(system)).solve(fixed),
        RBFInterpolator(places, one, kernel="linear", degree=1, smoothing=0.05)(points),
        RBFInterpolator(places, one, kernel="thin_plate_spline", smoothing=0.05)(points),
    ]


def _scores(face: Face, places: np.ndarray, found: list[np.ndarray], sd: np.ndarray) -> np.ndarray:
    used = np.zeros(len(sd[0]), bool)
    used[np.concatenate(face.polygons)] = True
    away, size = KDTree(places).query(face.points)[0], np.linalg.norm(face.motion, axis=2)
    skin = used & face.outer & (away > 0.1)
    moving = skin & (size.max(axis=0) > MOVING_MM)
    lids, still = skin & (face.lids > 0.3), skin & (size.max(axis=0) < STILL_MM)
    near, far = moving & (away < NEAR_MM), moving & (away > FAR_MM)
    regions = (moving, near, far, used & (face.lip != 0), lids, still)
    out = np.full((len(found) + 3, len(regions)), np.nan)
    large = size[:, moving].mean(axis=1)
    large_frames = large > np.quantile(large, 0.75)
    within = np.abs(found[0] - face.motion) < NORMAL_90 * sd[:, :, None]
    for column, region in enumerate(regions):
        if region.any():
            errors = [((each - face.motion)[:, region] ** 2).sum(axis=2).mean() for each in found]
            out[:-3, column] = np.sqrt(errors)
            out[-2, column] = within[:, region].mean()
            out[-1, column] = within[large_frames][:, region].mean()
    upper, lower = used & (face.lip > 0), used & (face.lip < 0)
    gaps = [
        each[:, upper].mean(axis=1) - each[:, lower].mean(axis=1)
        for each in (face.motion, found[0])
    ]
    out[-3, 0] = (gaps[0] * gaps[1]).sum() / (gaps[0] ** 2).sum()
    return out
