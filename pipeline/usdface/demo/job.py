"""The demo: generates its inputs, writes its job, and runs it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.capture.face_landmarker import FaceLandmarker, check_model
from usdface.core.arrays import FloatArray, columns_by_name
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.text import shell_word
from usdface.demo import JOB_NAME
from usdface.demo.build import (
    CLIP_SIZE,
    FOCAL_LENGTH,
    OFFSET_SECONDS,
    DemoInputs,
    weights_on_video,
    write_demo_inputs,
    write_weights,
)
from usdface.demo.script import NEUTRAL_TIME
from usdface.model.mapping.evaluation import SkinMetric
from usdface.model.review.moments import region_distances
from usdface.runner.job import JobEvents, run_job
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.capture import CleanSpec, IngestSpec, TrackSpec
from usdface.specs.job import JobSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.reading import read_job, spec_text
from usdface.specs.references import ReferencesImportSpec, SelectSpec
from usdface.specs.review import ReportSpec, SheetSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig

_PAIR_COUNT = 50
"""Number of references; the paper used 100."""

INPUTS_SHARE = 0.4
"""Share of the demo's time that its inputs take."""


def run_demo(
    folder: Path,
    *,
    model: Path | None = None,
    video_lines: int = CLIP_SIZE[1],
    progress: Progress = silent,
    events: JobEvents | None = None,
) -> StepResult:
    """Make the demo in a folder, or bring it up to date; the result states its error.

    `model`: face landmark model of `track`; the face is then tracked in the clip instead of using
    the captured markers. `video_lines`: height of the actor's clip [pixels], even. `events`: called
    as the steps of the job start and end.
    """
    confine("demo", writes=[folder])
    if model is not None:  # before two minutes of drawing
        check_model(model)
        with FaceLandmarker(model):
            pass
    job_file = folder / JOB_NAME
    make_folder(folder, job_file)
    inputs = write_demo_inputs(
        folder, video_lines=video_lines, progress=part(progress, 0.0, INPUTS_SHARE)
    )
    if model is not None:
        truth = weights_on_video(inputs.truth)
        keys = folder / "video_weights.csv"
        write_weights(keys, truth, read_rig(inputs.rig).shapes)
        inputs = replace(inputs, truth=truth, animator_weights=keys)
    job = _job(inputs, folder, model)
    job_file.write_text(_HEADER + spec_text(job, job_file), encoding="utf-8")
    reports = run_job(read_job(job_file), progress=part(progress, INPUTS_SHARE, 1.0), events=events)
    error = _error_of_other_frames(inputs, folder)
    outputs = tuple(dict.fromkeys(path for report in reports for path in report.outputs))
    return StepResult(
        (job_file, *outputs),
        f"{len(error)} frames that were not keyed: error of the skin {np.mean(error):.2f} mm on "
        f"average, {np.percentile(error, 95):.2f} mm at the 95th percentile",
        (
            f"look at {folder / 'demo.sheet.jpg'}, open {folder / 'demo.report.html'} in a browser "
            f"and {folder / 'demo.character.usda'} in a USD viewer",
            f"change {job_file} and run it again: usdface run {shell_word(job_file)}",
        ),
        {
            "surface_error_mm": float(np.mean(error)),
            "surface_error_p95_mm": float(np.percentile(error, 95)),
            "job": str(job_file),
            "sheet": str(folder / "demo.sheet.jpg"),
            "report": str(folder / "demo.report.html"),
        },
    )


_HEADER = """\
# The demo's job: run it with `usdface run`, check it with `usdface check`.
# Steps whose outputs are up to date are skipped: after a change, only dependent steps run.
"""


def make_folder(folder: Path, job_file: Path) -> None:
    """Create a demo's folder; refuse one with other files and without the job file.

    The job file stands there from the start, so that an interrupted demo can be run again.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        strangers = any(folder.iterdir()) and not job_file.exists()
        if not strangers and not job_file.exists():
            job_file.write_text("# The inputs of this job are being made.\n", encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made or read: {error.strerror}; choose another --out"
        ) from error
    if strangers:
        raise InputError(f"{folder}: is not empty and holds no demo; choose another --out")


def _take(inputs: DemoInputs, folder: Path, model: Path | None) -> IngestSpec | TrackSpec:
    """Return the step that makes the take, from the actor's markers or, with `model`, the clip."""
    out, video = Path("demo.take.usda"), inputs.video.relative_to(folder)
    if model is None:
        return IngestSpec(
            sources=(inputs.capture.relative_to(folder),),
            out=out,
            video=video,
            video_offset=OFFSET_SECONDS,
            rigid=inputs.rigid_markers,
            neutral=inputs.neutral_frame,
            performer="the demo's actor",
            timecode="01:00:00:00",
        )
    truth = inputs.truth
    last = truth.first_frame + len(truth.values) - 1
    return TrackSpec(
        video=video,
        out=out,
        model=model.absolute(),
        face="largest",  # the model detects hair as a second face in some pictures
        frames=f"{truth.first_frame}-{last}",
        focal_length=FOCAL_LENGTH,
        neutral=truth.first_frame + int(NEUTRAL_TIME * truth.rate),
        performer="the demo's actor",
    )


def _job(inputs: DemoInputs, folder: Path, model: Path | None) -> JobSpec:
    """Return the job, with paths relative to the folder."""

    def local(path: Path) -> Path:
        return path.relative_to(folder)

    rig = local(inputs.rig)
    take, clean = Path("demo.take.usda"), Path("demo.clean.take.usda")
    references, mapping = Path("demo.references.usda"), Path("demo.mapping.usdc")
    performance = Path("demo.character.usda")
    return JobSpec(
        job="demo",
        steps=(
            _take(inputs, folder, model),
            CleanSpec(take=take, out=clean),
            SelectSpec(takes=(clean,), rig=rig, out=references, count=_PAIR_COUNT),
            # In a studio, an animator tunes the proposals; here the keys are known.
            ReferencesImportSpec(references=references, weights=local(inputs.animator_weights)),
            TrainSpec(references=references, out=mapping),
            # at 120 frames per second, marker noise is faster than facial motion
            MapSpec(
                take=clean,
                mapping=mapping,
                rig=rig,
                out=performance,
                temporal="whole" if model is None else "none",
            ),
            SheetSpec(
                performance=performance,
                take=clean,
                out=Path("demo.sheet.jpg"),
                against=local(inputs.animator_weights),
            ),
            ReportSpec(
                performance=performance,
                take=clean,
                out=Path("demo.report.html"),
                against=local(inputs.animator_weights),
                sheet=Path("demo.sheet.jpg"),
            ),
        ),
    )


def _error_of_other_frames(inputs: DemoInputs, folder: Path) -> FloatArray:
    """Return the error of the skin in all frames that are not references [mm]; see `SkinMetric`."""
    rig, truth = read_rig(inputs.rig), inputs.truth
    solved = read_performance(folder / "demo.character.usda").weights
    weights, wanted = (
        columns_by_name(each.values, each.names, rig.shapes).astype(np.float64)
        for each in (solved, truth)
    )
    metric = SkinMetric(rig, Deformer(rig))
    error = region_distances(metric.differences(weights, wanted), metric.grams[:1])[:, 0]
    keyed = read_references(folder / "demo.references.usda").frames - truth.first_frame
    return np.asarray(np.delete(error, keyed))
