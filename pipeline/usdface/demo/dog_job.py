"""Demo of retargeting: a human performance on a dog, with its timing (Song et al. 2011)."""

from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from usdface.core.arrays import columns_by_name
from usdface.core.assets import Rig
from usdface.core.controls import Controls, shape_controls
from usdface.core.progress import Progress, part, silent
from usdface.core.text import shell_word
from usdface.demo import DOG_JOB_NAME
from usdface.demo.acting import performance
from usdface.demo.dog import act, expressions, write_dog
from usdface.demo.job import make_folder
from usdface.demo.rig import demo_rig
from usdface.runner.job import JobEvents, run_job
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.job import JobSpec
from usdface.specs.reading import read_job, spec_text
from usdface.specs.retarget import (
    CyclicSpec,
    FindSequencesSpec,
    MakeSequenceSpec,
    PairsImportSpec,
    RetargetSpec,
    TrainRetargetSpec,
    WarpSpec,
)
from usdface.specs.review import FacesSpec
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.retarget.control_performance import writing_control_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

_STEP_FRAMES = 4
"""Step from the performance's 120 to 30 frames per second."""

_SMILE = range(121, 156)
"""Frames that the dog's own animation replaces: the change of mood to happiness."""
_DOG_FRAMES = 56
"""Length of that animation [frames]."""

_HEADER = """\
# From a human face to a dog: run it with `usdface run`, check it with `usdface check`.
# Pairs, regression, performance, the dog's animation of happiness, round-trip error.
"""


def run_dog_demo(
    folder: Path, *, progress: Progress = silent, events: JobEvents | None = None
) -> StepResult:
    """Write both characters, pairs and a sequence to a folder, and run the job."""
    confine("demo", writes=[folder])
    job_file = folder / DOG_JOB_NAME
    make_folder(folder, job_file)
    write_dog_inputs(folder, progress=part(progress, 0.0, 0.3))
    job = dog_job()
    job_file.write_text(_HEADER + spec_text(job, job_file), encoding="utf-8")
    reports = run_job(read_job(job_file), progress=part(progress, 0.3, 1.0), events=events)
    outputs = tuple(dict.fromkeys(path for report in reports for path in report.outputs))
    trained = next((report for report in reports if report.figures.get("scores")), reports[-1])
    return StepResult(
        (job_file, *outputs),
        trained.summary,
        (
            f"look at {folder / 'talk.faces.jpg'}, {folder / 'talk.cyclic.jpg'} and "
            f"{folder / 'talk.warp.jpg'}; open {folder / 'talk.warped.usda'} in a USD viewer",
            f"change {job_file} and run it again: usdface run {shell_word(job_file)}",
        ),
        {"job": str(job_file), **trained.figures},
    )


def write_dog_inputs(folder: Path, *, progress: Progress = silent) -> None:
    """Write a human and a dog, the human's performance, 34 pairs, and the dog's smile."""
    progress(0.0, "sculpting the human")
    write_rig(folder / "human.usdc", demo_rig())
    human = read_rig(folder / "human.usdc")
    progress(0.4, "sculpting the dog")
    dog = write_dog(folder / "dog.usdc")
    clip = performance().weights
    weights = columns_by_name(clip.values[::_STEP_FRAMES], clip.names, human.shapes).astype(
        np.float64
    )
    _write(folder / "talk.human.usda", human, shape_controls(human.shapes, weights))
    progress(0.8, "posing both")
    _, poses = expressions(human.shapes)
    _write(folder / "human_poses.usda", human, shape_controls(human.shapes, poses))
    _write(folder / "dog_poses.usda", dog, act(human.shapes, poses))
    # Happiness: a wince, an overshoot, and the actor's end pose. The first and last frames
    # equal the actor's, for a continuous transition.
    start = _SMILE.start - 1
    first, last = weights[start], weights[start + _DOG_FRAMES - 1]
    peak = np.zeros_like(first)
    for name, weight in (
        ("mouthSmileLeft", 1.0),
        ("mouthSmileRight", 1.0),
        ("browInnerUp", 1.0),
        ("browOuterUpLeft", 1.0),
        ("browOuterUpRight", 1.0),
        ("jawOpen", 0.6),
    ):
        peak[human.shapes.index(name)] = weight
    wince = first.copy()
    for name in ("browDownLeft", "browDownRight", "eyeSquintLeft", "eyeSquintRight"):
        wince[human.shapes.index(name)] = 0.7
    times = np.array([0, 11, 23, 34, _DOG_FRAMES - 1])
    keys = np.stack([first, wince, peak, 0.7 * peak, last])
    _write(
        folder / "dog_smile.usda",
        dog,
        act(human.shapes, PchipInterpolator(times, keys)(np.arange(_DOG_FRAMES))),
    )
    progress(1.0, "posed both")


def _write(path: Path, rig: Rig, controls: Controls) -> None:
    header = make_header(
        rig, shape_names=controls.shapes, rate=Fraction(30), first_frame=1, last_frame=len(controls)
    )
    with writing_control_performance(
        path, header, rig, joints=controls.joints, attributes=controls.attributes
    ) as writer:
        writer.append(controls)


def dog_job() -> JobSpec:
    """Return the job, with paths relative to the folder."""
    human, talk, dog = Path("human.usdc"), Path("talk.human.usda"), Path("talk.dog.usda")
    pairs, trained = Path("human_dog.pairs.usda"), Path("human_dog.retarget.usdc")
    smile, matches = Path("smile.sequence.usda"), Path("talk.matches.usda")
    warped = Path("talk.warped.usda")
    return JobSpec(
        job="dog",
        steps=(
            PairsImportSpec(
                source=Path("human_poses.usda"),
                target=Path("dog_poses.usda"),
                source_rig=human,
                target_rig=Path("dog.usdc"),
                attributes=("rig/lattice.*",),
                out=pairs,
            ),
            TrainRetargetSpec(pairs=pairs, source=talk, out=trained),
            RetargetSpec(source=talk, retargeting=(trained,), out=(dog,)),
            MakeSequenceSpec(
                source=talk,
                source_frames=f"{_SMILE.start}-{_SMILE.stop - 1}",
                target=Path("dog_smile.usda"),
                attributes=("rig/lattice.*",),
                label="happiness",
                out=smile,
            ),
            FindSequencesSpec(source=talk, sequence=(smile,), out=matches),
            WarpSpec(performance=dog, matches=matches, out=warped, curves=Path("talk.warp.jpg")),
            CyclicSpec(
                pairs=pairs,
                source=talk,
                every=5,
                out=(Path("talk.cyclic.json"), Path("talk.cyclic.jpg")),
            ),
            FacesSpec(performances=(talk, dog, warped), out=Path("talk.faces.jpg"), rows=6),
        ),
    )
