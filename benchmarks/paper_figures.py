"""The papers' figures, drawn by commands; `--out FOLDER` stores them.

D06 is Deng et al. (2006), S11 Song et al. (2011), W06 Wang et al. (2006). Both demos are made
first, which takes minutes. Diagrams and photographs are omitted.
"""

import contextlib
import io
import os
import shlex
import shutil
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.retarget import contradicted
from usdface.cli import main
from usdface.core.provenance import Provenance
from usdface.model.retarget.cyclic import evaluate_cyclic
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.usdio.retarget.pairs import read_pairs, write_pairs
from usdface.usdio.rig.read import read_rig

ALPHA_KEYS = 7
"""Number of keys in figure 5 of S11."""

EVERY = 5
"""Every n-th frame is measured for it."""

_D06 = (
    ("train demo.references.usda --method d06 --out d06.mapping.usdc --picture fig3.jpg", "fig3"),
    ("references sheet demo.references.usda --takes demo.clean.take.usda --paper --pairs 1-6 "
     "--out fig5.jpg", "fig5"),
    ("map demo.clean.take.usda --baseline --rig character.usdc --out baseline.usda", ""),
    ("sheet demo.character.usda --take demo.clean.take.usda --against animator_weights.csv "
     "--rows 6 --out fig6.jpg", "fig6"),
    ("clean demo.take.usda --out again.clean.take.usda --report fig7.jpg", "fig7"),
)  # fmt: skip

_W06 = (
    ("deform demo.clean.take.usda --mesh character.usdc --mesh-prim /character/geometry/skin "
     "--frames 130-190 --rows 3 --picture fig3_4.jpg --picture-noise 0.7 --out skin.usda",
     "fig3_4"),
    ("deform demo.clean.take.usda --mesh character.usdc --mesh-prim /character/geometry/skin "
     "--frames 130-190 --rows 3 --picture fig3_no_folds.jpg --no-folds --out plain.usda",
     "fig3_no_folds"),
    ("make-shapes demo.clean.take.usda --mesh character.usdc --mesh-prim /character/geometry/skin "
     "--count 8 --picture fig5_6.jpg --out skin.rig.usda", "fig5_6"),
)  # fmt: skip

_S11 = (
    ("warp talk.dog.usda --matches talk.matches.usda --out fig1.usda --curves fig1.jpg", "fig1"),
    ("retarget talk.human.usda --source-rig human.usdc --rig dog.usdc --out positions.usda", ""),
    ("faces talk.human.usda positions.usda talk.dog.usda --rows 4 --out fig2.jpg", "fig2"),
    ("train-retarget human_dog.pairs.usda --method rbf --out rbf.usdc", ""),
    ("train-retarget human_dog.pairs.usda --method kernel_cca --published --out kcca.usdc", ""),
    ("retarget talk.human.usda --retargeting rbf.usdc --out rbf.usda --retargeting kcca.usdc "
     "--out kcca.usda", ""),
    ("faces talk.human.usda kcca.usda rbf.usda --rows 4 --out fig4.jpg", "fig4"),
    (f"cyclic human_dog.pairs.usda --source talk.human.usda --every {EVERY} --published "
     "--methods rbf,kernel_cca,hybrid --alpha alpha.csv --out fig5.jpg --out fig5.json", "fig5"),
    (f"cyclic contradicted.pairs.usda --source talk.human.usda --every {EVERY} --published "
     "--methods rbf,kernel_cca --out fig5_conflicts.jpg --out fig5_conflicts.json",
     "fig5_conflicts"),
    ("retarget talk.human.usda --rig ../demo/character.usdc --out names.usda", ""),
    ("faces talk.human.usda talk.dog.usda names.usda --rows 4 --out fig6.jpg", "fig6"),
)  # fmt: skip


def run(*, pictures: Path | None = None) -> None:
    """Draw every figure, and print its path and command."""
    before = Path.cwd()
    keep = None if pictures is None else pictures.resolve()
    print("| figure | command |")
    print("|---|---|")
    with tempfile.TemporaryDirectory() as name:
        try:
            os.chdir(name)
            _call("demo --out demo --progress none")
            _call("demo --dog --out dog --progress none")
            _key_alpha(Path("dog"))
            _contradict(Path("dog"))
            for paper, folder, commands in (
                ("D06", "demo", _D06),
                ("S11", "dog", _S11),
                ("W06", "demo", _W06),
            ):
                os.chdir(Path(name) / folder)
                for line, figure in commands:
                    _call(f"{line} --progress none --overwrite")
                    if figure:
                        print(f"| {paper} {figure} | `usdface {line}` |", flush=True)
                    if figure and keep is not None:
                        for file in Path().glob(f"{figure}*.jpg"):
                            shutil.copy(file, keep / f"{paper}_{file.name}")
        finally:
            os.chdir(before)


def _call(line: str) -> None:
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # keep the table only
            main(shlex.split(line))
    except SystemExit as stopped:
        if stopped.code:
            raise RuntimeError(f"usdface {line}: exit {stopped.code}") from stopped


def _key_alpha(folder: Path) -> None:
    """Key alpha per range of frames by the part of the hybrid with the smaller error."""
    pairs = read_pairs(folder / "human_dog.pairs.usda")
    rig, target = read_rig(folder / "human.usdc"), read_rig(folder / "dog.usdc")
    motion = read_source_motion(folder / "talk.human.usda", None)
    columns = [motion.names.index(name) for name in pairs.source_shapes]
    weights = motion.weights[::EVERY, columns]
    network, regression = evaluate_cyclic(
        pairs, weights, methods=("rbf", "kernel_cca"), rig=rig, target_rig=target
    )
    better = network.mean_vertex_mm < regression.mean_vertex_mm
    lines = ["frame,alpha"]
    for rows in np.array_split(np.arange(len(weights)), ALPHA_KEYS):
        frame = motion.first_frame + EVERY * int(rows[len(rows) // 2])
        lines.append(f"{frame},{float(better[rows].mean()):.2f}")
    (folder / "alpha.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _contradict(folder: Path) -> None:
    """Write the demo's pairs and six contradictory ones."""
    write_pairs(
        folder / "contradicted.pairs.usda",
        contradicted(read_pairs(folder / "human_dog.pairs.usda")),
        source_rig=read_rig(folder / "human.usdc"),
        target_rig=read_rig(folder / "dog.usdc"),
        provenance=Provenance(),
    )
