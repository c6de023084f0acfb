"""Chains that do not start from one take: jobs of several takes, retargeting, meshes."""

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.matrix import rigs
from tests.matrix.chain import Case, write_inputs
from tests.matrix.studio import SAME, Studio, assert_same
from tests.small_scan import FIRST, FRAMES, landmarks, small_scan, small_scan_take, write_scan
from tests.steps.small_shot import coarse_rig
from usdface.core.arrays import columns_by_name
from usdface.core.assets import Rig
from usdface.core.provenance import Provenance
from usdface.demo.acting import performance
from usdface.demo.dog import expressions
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.write import write_take

pytestmark = pytest.mark.slow

JOB = """
job: Tag 3 ü
takes:
  - {take: Ä b.c, rest: 8}
  - {take: Ä b.d, rest: 1002}
steps:
  - for_each: take
    steps:
      - {step: ingest, sources: ["{take}.c3d"], out: "{take}.take.usda", neutral: "{rest}"}
      - {step: clean, take: "{take}.take.usda", out: "{take}.clean.take.usda"}
  - step: select
    takes: ["{take}.clean.take.usda"]
    rig: hero.usdc
    count: 24
    out: r.references.usda
  - {step: references-import, references: r.references.usda, weights: all.csv}
  - {step: train, references: r.references.usda, out: m.usdc, method: face_map}
  - for_each: take
    steps:
      - step: map
        take: "{take}.clean.take.usda"
        mapping: m.usdc
        rig: hero.usdc
        out: "{take}.usda"
      - {step: evaluate, performance: "{take}.usda", against: all.csv, out: ["{take}.json"]}
      - {step: package, performance: "{take}.usda", out: "{take}.usdz"}
"""
TASKS = 13
AGAIN = "map {T} --mapping m.usdc --rig {R} --out x.usda --overwrite"


def test_a_job_of_two_takes_in_one_folder(tmp_path: Path) -> None:
    folder = tmp_path / "Tag 3 ü"
    folder.mkdir()
    rate = Fraction(30000, 1001)
    cases = Case(take="Ä b.c", rate=rate), Case(take="Ä b.d", rate=rate, start=0.2, first=1001)
    studios, table = [], ["take,"]
    for case in cases:
        studios.append(write_inputs(folder, case))
        header, *rows = (folder / "keys.csv").read_text(encoding="utf-8").split()
        table = [f"take,{header}", *table[1:], *(f"{case.take},{row}" for row in rows)]
    (folder / "all.csv").write_text("\n".join(table), encoding="utf-8")
    (folder / "day.job.yaml").write_text(JOB, encoding="utf-8")
    day = studios[0]
    (before,) = day.run("check day.job.yaml")
    assert "up to date" not in before
    day.run("submit day.job.yaml --write-only --out bundle\nrun day.job.yaml")
    assert len(list((folder / "bundle").rglob("tasks/*/*.yaml"))) == TASKS
    (after,) = day.run("check day.job.yaml")
    assert after.count("up to date") == TASKS
    for studio, case in zip(studios, cases, strict=True):
        studio.check_file(folder / f"{case.take}.usda", (studio.first, studio.last))
        studio.run(AGAIN)
        for alike in (f"{case.take}.usda", f"{case.take}.usdz"):
            assert_same(studio.weights(alike), studio.weights("x.usda"))


RETARGET = """
pairs propose --source s.usdc --target t.usdc --out pp.pairs.usda
pairs import --source sposes.csv --target tposes.csv \\
  --source-rig s.usdc --target-rig t.usdc --out pi.pairs.usda
train-retarget pp.pairs.usda --method additive --out pp.rt.usdc
train-retarget pi.pairs.usda --source talk.usda --out pi.rt.usdc
train-retarget pi.pairs.usda --method hybrid --out hy.rt.usdc
describe pi.rt.usdc
retarget talk.usda --retargeting pp.rt.usdc --out proposed.usda
retarget talk.usda --retargeting pi.rt.usdc --out learned.usda
retarget talk.usda --retargeting hy.rt.usdc --out hybrid.usda
retarget talk.usda --rig t.usdc --names names.csv --out named.usda
cyclic pi.pairs.usda --source talk.usda --every 10 \\
  --methods auto,ridge,positions --out c.json --out c.jpg
make-sequence --source talk.usda --source-frames 10-40 \\
  --target smile.usda --label joy --out joy.sequence.usda
find-sequences talk.usda --sequence joy.sequence.usda --out m.usda
warp named.usda --matches m.usda --out w.usda --curves w.jpg
warp named.usda --matches m.usda --timing fit --out fit.usda
edit w.usda --shape {jaw} --add 0.2 --frames 20-30
faces talk.usda named.usda w.usda --out f.jpg --rows 1 --tile 64 --quality draft
evaluate named.usda --against talk.usda
bake w.usda --out baked.usdc
package w.usda --out w.usdz
combine named.usda w.usda --takes a,b --out all.usda
validate w.usda
validate pi.pairs.usda
validate joy.sequence.usda
sheet w.usda --out s.jpg --rows 1 --tile 64 --quality draft
report w.usda --out w.html
"""


def write_table(path: Path, *rows: Iterable[object]) -> None:
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")


def write_acted(path: Path, rig: Rig, weights: np.ndarray, rate: Fraction) -> None:
    last = len(weights)
    header = make_header(rig, shape_names=rig.shapes, rate=rate, first_frame=1, last_frame=last)
    with writing_performance(path, header, rig) as writer:
        writer.append(weights)


TARGETS = {
    "combinations": (rigs.with_combinations, Fraction(24000, 1001)),
    "five shapes": (rigs.with_five_shapes, Fraction(250)),
    "unicode": (lambda: rigs.renamed("Größe_{name}"), Fraction(30000, 1001)),
}


@pytest.mark.parametrize("target", TARGETS)
def test_a_performance_is_retargeted(target: str, tmp_path: Path) -> None:
    make, rate = TARGETS[target]
    write_rig(tmp_path / "s.usdc", coarse_rig())
    write_rig(tmp_path / "t.usdc", make())
    source, rig = read_rig(tmp_path / "s.usdc"), read_rig(tmp_path / "t.usdc")
    clip = performance().weights
    weights = columns_by_name(clip.values[::16], clip.names, source.shapes)
    studio = Studio(tmp_path, rate, 1, len(weights))
    kept = [k for k, name in enumerate(source.shapes) if {name, f"Größe_{name}"} & {*rig.shapes}]
    poses = expressions(source.shapes)[1]
    for name, each, values in (("sposes", source, poses), ("tposes", rig, poses[:, kept])):
        rows = ([k, *row] for k, row in enumerate(values, start=1))
        write_table(tmp_path / f"{name}.csv", ["frame", *each.shapes], *rows)
    pairs = zip((source.shapes[k] for k in kept), rig.shapes, strict=True)
    write_table(tmp_path / "names.csv", ["source", "target"], *pairs)
    write_acted(tmp_path / "talk.usda", source, weights, rate)
    write_acted(tmp_path / "smile.usda", rig, 0.9 * weights[40:71, kept], rate)
    studio.run(RETARGET, jaw=rig.shapes[kept.index(source.shapes.index("jawOpen"))])
    for name, largest in (("named.usda", SAME), ("learned.usda", 0.15), ("hybrid.usda", 0.15)):
        moved = studio.weights(name)
        columns = [moved.names.index(shape) for shape in rig.shapes]
        error = np.abs(moved.values[:, columns] - weights[:, kept])
        assert np.sqrt((error**2).mean()) <= largest, name
    named, warped = studio.weights("named.usda"), studio.weights("w.usda")
    changed = np.flatnonzero(np.abs(warped.values - named.values).max(axis=1) > 1e-4) + 1
    assert 10 in changed or 11 in changed
    assert_same(studio.weights("w.usdz"), studio.weights("baked.usdc"))
    if rig.combinations:
        for name in ("named.usda", "learned.usda", "w.usda", "baked.usdc"):
            rigs.assert_driven(studio.weights(name))


SURFACE = """
bind talk.take.usda scan.usdc --out b.binding.usda --landmarks {points} \\
  --picture b.jpg --quality draft
deform talk.take.usda --mesh scan.usdc --binding b.binding.usda \\
  --samples 20 --burn-in 10 --out d.usda
deform talk.take.usda --mesh scan.usdc --binding b.binding.usda --method rbf --out rbf.usda
make-shapes talk.take.usda --mesh scan.usdc --binding b.binding.usda --count 4 \\
  --samples 20 --burn-in 10 --out rig.usda
select talk.take.usda --rig rig.usda --count 8 --out r.references.usda
train r.references.usda --method ridge --out m.usdc
map talk.take.usda --mapping m.usdc --rig rig.usda --out p.usda
sheet p.usda --out s.jpg --rows 1 --tile 64 --quality draft
bake p.usda --out baked.usdc
package p.usda --out p.usdz
validate d.usda
validate rig.usda
validate p.usda --worst-verdict bad
"""


@pytest.mark.parametrize(
    ("rate", "z_up"), [(Fraction(24000, 1001), False), (Fraction(250), True)], ids=["23.976", "250"]
)
def test_a_mesh_without_shapes_follows_a_take(rate: Fraction, z_up: bool, tmp_path: Path) -> None:
    scan = small_scan()
    take = replace(small_scan_take(scan), rate=rate, timecode_start="")
    write_take(tmp_path / "talk.take.usda", take, provenance=Provenance())
    write_scan(tmp_path / "scan.usdc", scan, z_up=z_up)
    studio = Studio(tmp_path, rate, FIRST, FIRST + FRAMES - 1)
    studio.run(SURFACE, points="'" + ",".join(landmarks(scan)) + "'")
    time = 2 * np.pi / (FRAMES - 1) * 20
    truth = scan.moved((1 - np.cos(time)) / 2, max(np.sin(2 * time), 0), max(np.sin(3 * time), 0))
    acted = np.linalg.norm(truth - scan.points, axis=1)
    for name in ("d.usda", "rbf.usda"):
        studio.check_file(tmp_path / name, (studio.first, studio.last))
        stage = Usd.Stage.Open(str(tmp_path / name))
        (mesh,) = (UsdGeom.Mesh(x) for x in stage.Traverse() if x.IsA(UsdGeom.Mesh))
        rest, moved = (np.array(mesh.GetPointsAttr().Get(f), float) for f in (FIRST, FIRST + 20))
        scale = np.array(UsdGeom.XformCache(FIRST).GetLocalToWorldTransform(mesh.GetPrim()))[:3, :3]
        gone = np.linalg.norm((moved - rest) @ scale, axis=1)
        gone *= UsdGeom.GetStageMetersPerUnit(stage) * 1000
        error = gone - acted
        assert np.sqrt((error**2).mean()) < 0.25 * np.sqrt((acted**2).mean()), name
