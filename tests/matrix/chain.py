"""Everything from a capture to a publish, on one take and one rig, with what is true of it."""

import json
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from shlex import quote

import numpy as np
from pxr import Usd

from tests.c3d_write import write_c3d
from tests.edited_weights import read_weights
from tests.matrix.studio import SAME, Studio, Weights, assert_same
from tests.steps.small_shot import coarse_head, coarse_rig
from usdface.core.assets import Rig, WeightsClip
from usdface.demo.acting import ActedPerformance, performance
from usdface.demo.build import write_weights
from usdface.demo.capture import demo_markers, simulate_capture
from usdface.demo.sculpt import ACTOR
from usdface.publish import (
    ReviewOptions,
    collect_performances,
    extract_performance,
    integrate_performance,
    validate_performance,
)
from usdface.steps.review.clock import HIGHEST_RATE
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.write import write_rig

COUNT = 24
METHODS = ("face_map", "d06", "ridge", "rbf", "multiquadric", "kernel_cca", "hybrid", "auto")
LARGEST_ERROR = 0.05
"""Root mean square error of the weights against the keys. That of weights of 0 is 0.096, that of
the least accurate method, d06, 0.038, and of all others below 0.016."""
SIMULATED_SECONDS = 0.6
"""Shortest capture with gaps of all lengths."""
MOST_HEAD_CM = 0.3
"""Largest motion of a marker on the skull in a cleaned take; of the noise it is 0.08."""
MOVIE_FRAMES = 18
"""Its halves last no whole number of pictures at 120 and 250 frames per second."""

START = """
ingest {t}.c3d --out {t}.take.usda --neutral {neutral} {timecode}
clean {t}.take.usda --out {T}
place {T} --rig {R} {face} --out p.placement.usda --picture p.jpg --quality draft
select {T} --rig {R} {face} --out r.references.usda --count {n}
references import r.references.usda --weights keys.csv
"""
SOLVE = """
train r.references.usda --out {m}.usdc --method {m}
map {T} --rig {R} {map_face} --mapping {m}.usdc --out {m}.usda
evaluate {m}.usda --against keys.csv --out {m}.json
describe {m}.usdc
"""
REVIEW = """
select {T} --rig {R} {face} --out r.references.usda --count {n2} --mapping face_map.usdc --overwrite
references coverage r.references.usda {T} --out coverage.png
references sheet r.references.usda --out r.jpg --tile 64 --quality draft
map {T} --rig {R} {map_face} --baseline --out baseline.usda
map {T} --rig {R} {map_face} --mapping face_map.usdc --temporal whole --out whole.usda
map {T} --rig {R} {map_face} --mapping face_map.usdc --temporal causal --out causal.usda
map {T} --rig {R} {map_face} --mapping face_map.usdc --chunk 50 --out chunks.usda
map {T} --rig {R} {map_face} --mapping face_map.usdc --frames {first}-{middle} --out a.usda
map {T} --rig {R} {map_face} --mapping face_map.usdc --frames {next}-{last} --out b.usda
join a.usda b.usda --out joined.usda
movie face_map.usda --height 90 --out all.mp4 --frames {first}-{end}
movie face_map.usda --height 90 --out 1.mp4 --frames {first}-{half}
movie face_map.usda --height 90 --out 2.mp4 --frames {second}-{end}
movie-join 1.mp4 2.mp4 --take {T} --out joined.mp4
sheet face_map.usda --against keys.csv --out s.jpg --rows 1 --tile 64 --quality draft
report face_map.usda --against keys.csv --out r.html
faces face_map.usda baseline.usda --out f.jpg --rows 1 --tile 64 --quality draft
names face_map.usda {R} --out names.csv {faces}
"""
EDIT = """
edit face_map.usda --shape {raised} --add 0.2 --frames {low}-{high}
edit face_map.usda --shape {set} --override 0.5 --frames {low}-{high}
edits list face_map.usda
bake face_map.usda --out baked.usdc
edits import face_map.usda --changed baked.usdc
evaluate face_map.usda --against baked.usdc --out baked.json
references from-edits face_map.usda --references r.references.usda --out r2.references.usda
references add face_map.usda --references r.references.usda --frames {new} --out r3.references.usda
train r3.references.usda --method face_map --out again.usdc
combine face_map.usda baseline.usda --takes solve,baseline --out all.usda
package face_map.usda --out p.usdz
"""
LAYERS = ("{T}", "{R}", "face_map.usda", "all.usda", "p.usdz", "r.references.usda")


@dataclass(frozen=True)
class Case:
    """What one chain starts from."""

    rig: Rig = field(default_factory=coarse_rig)
    acted: ActedPerformance = field(default_factory=performance)
    rate: Fraction = Fraction(120)
    first: int = 1
    start: float = 0.0  # [s] of the performance
    seconds: float = 4.0
    take: str = "shot"
    rig_file: str = "hero.usdc"
    prim: str = ""  # the face in the rig's file
    keyed: tuple[str, ...] = ()  # names of the rig's shapes in the performance, if they differ
    timecode: str = ""
    lost_share: float = 0.0  # of samples, in addition to the gaps of the demo
    methods: tuple[str, ...] = METHODS[:1]


def sampled_performance(case: Case) -> ActedPerformance:
    """Return the performance at the rate of the case."""
    clip, rate = case.acted.weights, float(case.acted.weights.rate)
    own = np.arange(len(clip.values)) / rate
    times = case.start + np.arange(int(case.seconds * case.rate)) / float(case.rate)
    weights, turn, move = (
        np.stack([np.interp(times, own, column) for column in values.T], axis=1)
        for values in (clip.values, case.acted.rotation, case.acted.translation)
    )
    rest = (case.acted.neutral_frame - clip.first_frame) / rate - case.start
    neutral = case.first + max(round(rest * case.rate), 0)
    values = weights.astype(np.float32)
    return ActedPerformance(
        WeightsClip(clip.names, values, case.first, case.rate), neutral, turn, move
    )


def write_inputs(folder: Path, case: Case) -> Studio:
    """Write the capture, the keys and the rig of a case."""
    acted, actor = sampled_performance(case), coarse_head(ACTOR)
    markers, count = demo_markers(actor), len(acted.rotation)
    longer = replace(case, seconds=max(case.seconds, SIMULATED_SECONDS))
    positions, visible = simulate_capture(actor, sampled_performance(longer), markers)
    lost = np.random.default_rng(1).random(visible.shape) < case.lost_share
    lost[acted.neutral_frame - case.first] = False
    seen = (visible & ~lost)[:count]
    capture = folder / f"{case.take}.c3d"
    rate, first = case.rate, case.first
    write_c3d(capture, positions[:count], seen, markers.names, rate=rate, first_frame=first)
    shapes = dict(zip(case.keyed or case.rig.shapes, case.rig.shapes, strict=True))
    known = [k for k, name in enumerate(acted.weights.names) if name in shapes]
    names = tuple(shapes[acted.weights.names[k]] for k in known)
    keys = replace(acted.weights, names=names, values=acted.weights.values[:, known])
    write_weights(folder / "keys.csv", keys, case.rig.shapes)
    if not (folder / case.rig_file).exists():
        write_rig(folder / case.rig_file, case.rig)
    return Studio(folder, rate, first, first + count - 1, words_of(case, acted))


def words_of(case: Case, acted: ActedPerformance) -> dict[str, object]:
    """Return what stands for the names in braces of the commands."""
    first, count = case.first, len(acted.rotation)
    last, shown, prim = first + count - 1, min(count, MOVIE_FRAMES), case.prim
    return {
        "t": quote(case.take),
        "T": quote(f"{case.take}.clean.take.usda"),
        "R": case.rig_file,
        "neutral": acted.neutral_frame,
        "timecode": f"--timecode '{case.timecode}'" if case.timecode else "",
        "face": f"--prim {prim}" if prim else "",
        "faces": f"--prim {prim} --prim {prim}" if prim else "",
        "map_face": f"--rig-prim {prim}" if prim else "",
        "n": min(COUNT, count // 3),
        "n2": min(COUNT, count // 3) + 2,
        **{"first": first, "middle": (first + last) // 2, "next": (first + last) // 2 + 1},
        **{"last": last, "low": first + 2, "high": min(first + 40, last - 1)},
        **{"half": first + shown // 2 - 1, "second": first + shown // 2, "end": first + shown - 1},
        "set": quote(case.rig.shapes[0]),
        "raised": quote(case.rig.shapes[-1]),
    }


def run_chain(folder: Path, case: Case) -> tuple[Studio, Weights]:
    """Run every command from ingest to publish; return the weights by the default method."""
    studio = write_inputs(folder, case)
    studio.run(START)
    check_take(studio, case)
    pairs = read_references(studio / "r.references.usda")
    assert pairs.tuned.all()
    for method in case.methods:
        studio.run(SOLVE, m=method)
        figures = json.loads((studio / f"{method}.json").read_text(encoding="utf-8"))
        assert figures["weight_rmse"] < LARGEST_ERROR, method
    studio.run(REVIEW)
    after = read_references(studio / "r.references.usda")
    assert np.array_equal(after.weights[after.tuned], pairs.weights)
    solve = studio.weights("face_map.usda")
    for alike in ("joined.usda", "chunks.usda"):
        assert_same(studio.weights(alike), solve)
        assert studio.weights(alike).timecode == case.timecode
    check_movie(studio)
    new = min({*range(studio.first, studio.last + 1)} - {*after.frames.tolist()})
    studio.run(EDIT, new=new)
    check_edits(studio, case, solve)
    baked = json.loads((studio / "baked.json").read_text(encoding="utf-8"))
    assert baked["weight_rmse"] < 1e-6
    studio.run("\n".join(f"validate {layer}" for layer in LAYERS))
    return studio, solve


def check_take(studio: Studio, case: Case) -> None:
    """Check that markers on the skull do not move in the cleaned take, and its names."""
    stage = Usd.Stage.Open(str(studio / f"{case.take}.clean.take.usda"))
    take, markers = stage.GetPrimAtPath("/Take"), stage.GetPrimAtPath("/Take/Markers")
    assert take.GetAttribute("face:take").Get() == case.take
    assert (take.GetAttribute("face:timecode:start").Get() or "") == case.timecode
    names = markers.GetAttribute("face:markers:names").Get()
    skull = [k for k, name in enumerate(names) if name.startswith("head_")]
    points = markers.GetAttribute("points")
    at = np.array([points.Get(frame) for frame in points.GetTimeSamples()])[:, skull]
    assert np.abs(at - np.median(at, axis=0)).max() < MOST_HEAD_CM


def check_movie(studio: Studio) -> None:
    """Check the rate and number of pictures of a movie, drawn whole and in two parts."""
    (rate, pictures), (joined_rate, joined) = map(studio.movie, ("all.mp4", "joined.mp4"))
    assert rate == joined_rate <= HIGHEST_RATE
    step = studio.rate / rate  # frames a picture
    assert step.denominator == 1
    assert pictures == -(-min(MOVIE_FRAMES, studio.last - studio.first + 1) // step)
    assert joined - pictures in (0, 1)  # the last picture of the last part may outlast its frames


def check_edits(studio: Studio, case: Case, solve: Weights) -> None:
    """Check the edited weights where they are baked, combined, packed and published."""
    baked = studio.weights("baked.usdc")
    expected = replace(solve, values=solve.values.copy())
    inside = slice(2, min(40, studio.last - studio.first - 1) + 1)
    expected[case.rig.shapes[-1]][inside] += 0.2
    expected[case.rig.shapes[0]][inside] = 0.5
    at = [baked.names.index(name) for name in case.rig.shapes]  # without combinations
    assert np.abs(baked.values - expected.values)[:, at].max() <= SAME
    assert np.abs(read_weights(studio / "all.usda").values - baked.values).max() <= SAME
    assert_same(studio.weights("p.usdz"), baked)
    assert baked.timecode == case.timecode
    (item,) = collect_performances([studio / "face_map.usda"])
    assert "error" not in [each.severity for each in validate_performance(item)]
    drawn = ReviewOptions(rows=1, quality="draft")
    version = integrate_performance(extract_performance(item, studio / "publish", review=drawn))
    published = version.folder / "face_map.weights.usdc"
    for layer in (published, version.folder / "face_map.usda"):
        studio.check_file(layer, (studio.first, studio.last))
    assert_same(studio.weights(str(published)), baked)
