"""A job runs what it lacks, says where it stands, and goes on after a failure."""

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.steps.small_shot import FRAMES, Shot
from usdface.cli import main
from usdface.cli import run as command
from usdface.cli.run import showing_events
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.runner import execute as executing
from usdface.runner import job as jobs
from usdface.runner.execute import execute
from usdface.runner.job import JobStep, run_job
from usdface.runner.result import StepResult
from usdface.runner.state import job_states
from usdface.specs.edits import CombineSpec
from usdface.specs.job import JobSpec
from usdface.specs.reading import read_job
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.performance.read import read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take
from usdface.usdio.validation import validate

STEPS = ["ingest", "clean", "select", "references-import", "train", "map", "sheet"]


def ran(shot: Shot, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run the job and return the steps it really ran."""
    done: list[str] = []
    execute = jobs.execute

    def spy(spec, **options):
        done.append(spec.step)
        return execute(spec, **options)

    monkeypatch.setattr(jobs, "execute", spy)
    run_job(read_job(shot / "shot.job.yaml"))
    monkeypatch.setattr(jobs, "execute", execute)
    return done


def test_the_whole_way_gives_weights_near_the_animators(finished_shot: Shot) -> None:
    performance = read_performance(finished_shot / "shot.hero.usda")
    rig = read_rig(finished_shot / "hero.usdc")
    truth = read_weight_table(finished_shot / "keys.csv").columns(performance.weights.names)
    error = performance.weights.values - truth[:FRAMES]
    order = [rig.shapes.index(name) for name in performance.weights.names]
    gram = Deformer(rig).shapes.gram()[np.ix_(order, order)]
    keyed = read_references(finished_shot / "hero.references.usda").frames - 1
    new = np.setdiff1d(np.arange(FRAMES), keyed)

    def surface(errors: np.ndarray) -> float:
        return float(np.sqrt(np.einsum("fs,st,ft->f", errors, gram, errors)).mean())

    at_rest = surface(truth[:FRAMES][new])
    assert surface(error[new]) < 0.5 * at_rest
    assert performance.timecode_start == "01:00:00:00"


def test_every_layer_that_was_written_passes_every_validator(finished_shot: Shot) -> None:
    layers = [
        "hero.usdc",
        "shot.take.usda",
        "shot.clean.take.usda",
        "hero.references.usda",
        "hero.mapping.usdc",
        "shot.hero.usda",
    ]
    for name in layers:
        assert validate(finished_shot / name) == [], name


def test_cleaning_keeps_the_heads_motion(finished_shot: Shot) -> None:
    raw = read_take(finished_shot / "shot.take.usda")
    clean = read_take(finished_shot / "shot.clean.take.usda")
    still, motion = clean.markers.positions.astype(float), clean.head_motion
    back = np.einsum("fij,fmj->fmi", motion[:, :3, :3], still) + motion[:, None, :3, 3]
    away = np.linalg.norm(back - raw.markers.positions, axis=2)[raw.markers.visible]
    assert np.median(away) < 0.5, "stabilised markers and head motion must give the capture back"
    travel = np.ptp(motion[:, :3, 3], axis=0).max()
    assert travel > 10, "the actor moved, so the motion must be there"


def test_a_second_run_has_nothing_to_do(shot: Shot, monkeypatch) -> None:
    # A moved folder changes no hash: paths are kept relative.
    assert ran(shot, monkeypatch) == []
    assert {state.state for state in job_states(read_job(shot / "shot.job.yaml"))} == {"done"}


def test_a_job_that_ran_from_its_folder_is_done_when_it_is_named_from_elsewhere(
    shot: Shot, monkeypatch
) -> None:
    # A take lies on others in several layers, and their hash must not depend on how paths sort.
    monkeypatch.chdir(shot.folder)
    near = job_states(read_job(Path("shot.job.yaml")))
    monkeypatch.chdir("/")
    far = job_states(read_job(shot / "shot.job.yaml"))
    assert {state.state for state in (*near, *far)} == {"done"}


@pytest.mark.usefixtures("without_comparison")
def test_only_what_depends_on_a_change_runs_again(shot: Shot, monkeypatch) -> None:
    keys = (shot / "keys.csv").read_text().splitlines()
    keys[40] = keys[40].replace("0.0000", "0.0100")
    (shot / "keys.csv").write_text("\n".join(keys))
    states = job_states(read_job(shot / "shot.job.yaml"))
    assert [state.state for state in states] == ["done"] * 3 + ["stale"] * 4
    assert "keys.csv has changed" in states[3].reason
    assert states[4].reason == "an earlier step rewrites hero.references.usda"
    assert ran(shot, monkeypatch)[0] == "references-import"


def test_other_settings_run_that_step_and_what_follows(shot: Shot, monkeypatch) -> None:
    job = shot / "shot.job.yaml"
    job.write_text(job.read_text().replace("rows: 2", "rows: 3"))
    assert job_states(read_job(job))[-1].reason.endswith("other options: rows was 2, is 3")
    assert ran(shot, monkeypatch) == ["sheet"]


def test_repeating_a_step_says_that_it_is_up_to_date(shot: Shot, monkeypatch) -> None:
    monkeypatch.setattr(executing, "find_step", None)
    spec = read_job(shot / "shot.job.yaml").steps[1]
    again = execute(spec)
    assert again.up_to_date
    assert again.outputs == (shot / "shot.clean.take.usda",)
    with pytest.raises(InputError, match="newer than its inputs"):
        execute(spec.model_copy(update={"max_gap": 3}))


def test_results_are_printed_as_steps_end_and_again_when_asked(shot: Shot, capsys) -> None:
    job = shot / "shot.job.yaml"

    def run(*options: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["run", str(job), *options])
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    job.write_text(job.read_text().replace("rows: 2", "rows: 3"))
    code, out, err = run()
    lines = out.splitlines()
    assert code == 0
    assert lines[0] == "step 1 of 7, ingest shot.take.usda: up to date"
    made = next(line for line in lines if line.startswith("step 7 of 7, sheet shot.sheet.jpg: "))
    assert "up to date" not in made
    assert "step 7 of 7, sheet shot.sheet.jpg ..." in err
    summary = made.partition("jpg: ")[2]
    assert f"  {summary}" in run("--notes")[1].splitlines()
    assert summary not in run()[1]
    (shot / "shot.sheet.jpg").write_bytes(b"mine")
    code, out, err = run()
    assert code == 2
    assert "step 6 of 7, map shot.hero.usda: up to date" in out
    assert "6 of 7 steps are done; run again to continue" in err
    code, out, _ = run("--json")
    assert code == 2
    data = json.loads(out)
    assert len(data["steps"]) == 6
    assert "was not written by usdface" in data["error"]


def test_stored_results_keep_every_character_and_are_left_out_if_too_large(
    tmp_path: Path, monkeypatch
) -> None:
    spec = CombineSpec(performances=(tmp_path / "a.usda",), out=tmp_path / "b.usda")
    step = JobStep(1, 1, spec, Provenance(step="combine", spec="{}"))
    result = StepResult((), "a summary\u2028of two lines", ("a note of\x85two",))

    def results(report: StepResult) -> StepResult:
        shown: list[StepResult] = []
        job = tmp_path / "day.job.yaml"
        showing_events(job, shown, style="none", as_json=True, again=True).ended(step, report)
        return shown[0]

    results(result)
    again = results(StepResult((), "up to date", up_to_date=True))
    assert (*again.table, *again.notes) == (result.summary, *result.notes)
    monkeypatch.setattr(command, "_LARGEST_NOTES_BYTES", 10)
    assert results(StepResult((), "up to date", up_to_date=True)).table == ("no stored notes",)
    results(result)
    assert (tmp_path / ".day.job.yaml.notes").read_text("utf-8").count("\n") == 1


def test_folders_that_are_not_there_are_named_once_with_the_remedy(shot: Shot) -> None:
    steps = read_job(shot / "shot.job.yaml").steps
    new = shot / "new"
    take = steps[0].model_copy(update={"out": new / "a.take.usda"})
    clean = steps[1].model_copy(update={"take": take.out, "out": new / "a.clean.take.usda"})
    with pytest.raises(InputError, match=r"1 output folder missing: .*--make-folders") as no:
        job_states(JobSpec(job="day", steps=(take, clean)))
    assert str(no.value).count("new") == 1


def test_a_job_that_failed_goes_on_where_it_stopped_and_gives_the_same_bytes(
    shot: Shot, monkeypatch
) -> None:
    names = ["shot.hero.weights.usdc", "hero.mapping.usdc", "shot.sheet.jpg"]
    before = {name: (shot / name).read_bytes() for name in names}
    for name in ("hero.mapping.usdc", "shot.hero.usda", "shot.hero.weights.usdc"):
        (shot / name).unlink()
    kept = (shot / "hero.usdc").rename(shot / "away.usdc")
    with pytest.raises(InputError, match=r"hero\.usdc: no such file"):
        run_job(read_job(shot / "shot.job.yaml"))
    kept.rename(shot / "hero.usdc")
    assert ran(shot, monkeypatch) == ["train", "map"]  # the same bytes: the sheet is up to date
    (shot / "shot.sheet.jpg").unlink()
    assert ran(shot, monkeypatch) == ["sheet"]
    assert {name: (shot / name).read_bytes() for name in names} == before


@pytest.mark.parametrize("name", ["hero.references.tuned.usda", "hero.mapping.usdc"])
def test_a_job_never_replaces_what_another_step_makes(shot: Shot, name: str) -> None:
    before = (shot / name).read_bytes()
    bake = {"step": "bake", "performance": shot / "shot.hero.usda", "out": shot / name}
    job = JobSpec.model_validate({"job": "typo", "steps": [bake]})
    with pytest.raises(InputError, match=rf"bake: .*{name}: exists and was written by `"):
        run_job(job)
    assert (shot / name).read_bytes() == before
    run_job(job, overwrite=True)
    assert (shot / name).read_bytes() != before


def test_a_job_never_replaces_a_file_of_someone_else(shot: Shot) -> None:
    (shot / "shot.sheet.jpg").write_bytes(b"my drawing")
    with pytest.raises(InputError, match=r"step 7 of 7, sheet:.*was not written by usdface"):
        run_job(read_job(shot / "shot.job.yaml"))
    assert (shot / "shot.sheet.jpg").read_bytes() == b"my drawing"


@pytest.mark.parametrize(
    ("main", "beside", "step"),
    [
        ("shot.take.usda", "shot.take.samples.usdc", "1 of 7, ingest"),
        ("hero.references.usda", "hero.references.proposed.usda", "3 of 7, select"),
        ("shot.hero.usda", "shot.hero.weights.usdc", "6 of 7, map"),
    ],
)
def test_a_file_of_someone_else_stays_where_a_step_would_write_a_layer(
    shot: Shot, main: str, beside: str, step: str
) -> None:
    (shot / main).unlink()
    theirs = Sdf.Layer.CreateAnonymous()
    theirs.Export(str(shot / beside))
    before = (shot / beside).read_bytes()
    job = read_job(shot / "shot.job.yaml")
    with pytest.raises(InputError, match=rf"step {step}: .*{beside}: exists and was not written"):
        run_job(job)
    spec = next(each for each in job.steps if each.step == step.split(", ")[1])
    with pytest.raises(InputError, match=f"{beside}: exists and was not written by usdface"):
        execute(spec)
    assert (shot / beside).read_bytes() == before


def test_checking_names_every_file_that_is_missing(shot: Shot) -> None:
    (shot / "shot.c3d").unlink()
    (shot / "keys.csv").unlink()
    with pytest.raises(InputError, match=r"shot\.c3d: no such file.*\n.*keys\.csv: no such file"):
        job_states(read_job(shot / "shot.job.yaml"))


@pytest.mark.parametrize(
    ("gone", "step"),
    [("shot.hero.weights.usdc", "map"), ("shot.take.samples.usdc", "ingest")],
)
def test_a_step_is_run_again_when_a_layer_beneath_its_output_is_gone(
    shot: Shot, monkeypatch: pytest.MonkeyPatch, gone: str, step: str
) -> None:
    before = (shot / gone).read_bytes()
    (shot / gone).unlink()
    states = {each.spec.step: each for each in job_states(read_job(shot / "shot.job.yaml"))}
    assert (states[step].state, states[step].reason) == ("missing", f"{gone} does not exist")
    assert step in ran(shot, monkeypatch)
    assert (shot / gone).read_bytes() == before


def test_no_temporary_file_is_left(finished_shot: Shot) -> None:
    assert list(finished_shot.folder.glob(".*")) == []
