"""Bundles: valid, the same bytes every time, and deaf to what names say."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from usdface.core.errors import InputError
from usdface.farm.bundle import FIRST_LINE, bundle_hash, compose_bundle, write_bundle
from usdface.farm.plan import FarmStep, plan_job
from usdface.farm.submit import submit
from usdface.media.picture.image import write_image
from usdface.specs.capture import CleanSpec
from usdface.specs.commands import SubmitSpec
from usdface.specs.job import JobSpec
from usdface.specs.reading import read_job

HOSTILE = [
    "{{Param.Job}}",
    "{{Session.WorkingDirectory}}",
    "{{ RawParam.Tasks }}",
    "$(touch pwned)",
    "`touch pwned`",
    "x; touch pwned",
    "x && touch pwned",
    "x | tee pwned",
    "'; touch pwned; '",
    '"; touch pwned; "',
    "--overwrite",
    "#IFRAME#",
    "%PATH%",
    "!include x",
    "&a *a",
    "- x: y",
    "Gesicht ü 顔",
]


def plan(take: str, job: str = "j") -> tuple[FarmStep, ...]:
    spec = CleanSpec(take=Path(f"/s/{take}"), out=Path(f"/s/{take}.out.usda"))
    found = plan_job(
        JobSpec(job=job, steps=(spec,)), SubmitSpec(job=Path("j.yaml")), frames_of=lambda path: None
    )
    return found.steps


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_reaches_a_template_or_a_command(name: str) -> None:
    hostile = compose_bundle("j", plan(name))
    harmless = compose_bundle("j", plan("harmless"))
    assert hostile["template.yaml"] == harmless["template.yaml"]
    task = yaml.safe_load(hostile["tasks/clean/1.yaml"])
    assert task["take"] == f"/s/{name}", "and the worker reads it as it is"


@pytest.mark.parametrize("name", HOSTILE)
def test_a_jobs_name_is_shown_as_it_is_and_never_read(name: str) -> None:
    model = pytest.importorskip("openjd.model", reason="needs the farm extra: openjd-model")
    template = yaml.safe_load(compose_bundle(name, plan("x"))["template.yaml"])
    assert template["name"] == "{{Param.Job}}"
    decoded = model.decode_job_template(template=template)
    values = model.preprocess_job_parameters(
        job_template=decoded,
        job_parameter_values={},
        job_template_dir=Path("/bundle"),
        current_working_dir=Path("/bundle"),
    )
    assert model.create_job(job_template=decoded, job_parameter_values=values).name == name


@pytest.mark.parametrize("name", ["a\nb", "\x1b[31m", " ", "x" * 129, "a\u202eb"])
def test_a_name_that_farms_refuse_is_refused_here(name: str) -> None:
    with pytest.raises(InputError, match="cannot name a job on a farm"):
        compose_bundle(name, plan("x"))


@settings(deadline=None)  # a busy machine is no fault
@given(st.text(st.characters(codec="utf-8"), min_size=1, max_size=40))
def test_what_a_path_says_comes_back_from_the_bundle(text: str) -> None:
    name = text.replace("/", "_").replace("\0", "_")
    if Path(f"/s/{name}").name != name:
        return
    (step,) = plan(name)
    task = yaml.safe_load(compose_bundle("j", (step,))["tasks/clean/1.yaml"])
    assert Path(task["take"]) == step.tasks[0].take


def test_the_same_job_is_the_same_bytes_and_another_is_not() -> None:
    first, again = compose_bundle("j", plan("x")), compose_bundle("j", plan("x"))
    assert first == again
    assert bundle_hash(first) == bundle_hash(again)
    others = [compose_bundle("k", plan("x")), compose_bundle("j", plan("y"))]
    assert len({bundle_hash(each) for each in (first, *others)}) == 3


def files_of(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_bundle_that_is_there_is_not_touched(tmp_path: Path) -> None:
    files = compose_bundle("j", plan("x"))
    write_bundle(tmp_path / "b", files)
    before = files_of(tmp_path)
    write_bundle(tmp_path / "b", files, overwrite=True)
    assert files_of(tmp_path) == before


def test_another_jobs_bundle_is_replaced_only_on_request(tmp_path: Path) -> None:
    folder = tmp_path / "b"
    write_bundle(folder, compose_bundle("j", plan("x")))
    other = compose_bundle("j", plan("y"))
    with pytest.raises(InputError, match="bundle of another job, which may still be running"):
        write_bundle(folder, other)
    write_bundle(folder, other, overwrite=True)
    assert "/s/y" in (folder / "tasks/clean/1.yaml").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_what_a_killed_process_left_beside_a_bundle_goes(tmp_path: Path) -> None:
    (tmp_path / ".b.bundle" / "new").mkdir(parents=True)
    write_bundle(tmp_path / "b", compose_bundle("j", plan("x")))
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_a_bundle_that_cannot_be_replaced_is_kept(tmp_path: Path, monkeypatch) -> None:
    folder = tmp_path / "b"
    write_bundle(folder, compose_bundle("j", plan("x")))
    rename = Path.rename

    def fail(path: Path, target: Path) -> Path:
        if path.name == "new":
            raise OSError(28, "No space left on device")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        write_bundle(folder, compose_bundle("j", plan("y")), overwrite=True)
    assert "/s/x" in (folder / "tasks/clean/1.yaml").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_a_folder_with_something_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="exists and is not a bundle"):
        write_bundle(tmp_path, compose_bundle("j", plan("x")), overwrite=True)
    assert (tmp_path / "thesis.txt").is_file()
    with pytest.raises(InputError, match="does not exist; make it first"):
        write_bundle(tmp_path / "no" / "b", compose_bundle("j", plan("x")))


def test_what_workers_need_is_named_and_what_they_make_is_not(tmp_path: Path) -> None:
    references = yaml.safe_load(
        compose_bundle("j", plan("x"), carried=[Path("/s/x.samples.usdc")])["asset_references.yaml"]
    )["assetReferences"]
    assert references["inputs"]["filenames"] == ["/s/x", "/s/x.samples.usdc"]
    assert references["outputs"]["directories"] == ["/s"]


def test_all_pictures_of_a_sequence_are_carried_to_a_farm(tmp_path: Path) -> None:
    for number in (7, 8):
        write_image(tmp_path / f"shot.{number}.png", np.zeros((8, 8, 3), np.uint8))
    take = """#usda 1.0
( defaultPrim = "Take" )
def "Take" ( prepend apiSchemas = ["FaceTakeAPI"] )
{
    asset face:video:file = @shot.7.png@
}
"""
    (tmp_path / "in.usda").write_text(take)
    job = tmp_path / "job.yaml"
    for step, others in (
        ("{step: track, video: shot.7.png, video_rate: 24, out: a.take.usda}", []),
        ("{step: clean, take: in.usda, out: b.take.usda}", ["in.usda"]),
    ):
        job.write_text(step)
        bundle = submit(SubmitSpec(job=job, write_only=True)).bundle
        carried = yaml.safe_load((bundle / "asset_references.yaml").read_text())["assetReferences"]
        names = [Path(each).name for each in carried["inputs"]["filenames"]]
        assert names == [*others, "shot.7.png", "shot.8.png"]


def test_a_job_whose_input_is_missing_is_refused_before_it_waits_in_a_queue(tmp_path: Path) -> None:
    job = tmp_path / "job.yaml"
    steps = [
        {"step": "clean", "take": "no.usda", "out": "a.usda"},
        {"step": "clean", "take": "a.usda", "out": "b.usda"},
    ]
    job.write_text(yaml.safe_dump({"job": "j", "steps": steps}))
    with pytest.raises(InputError, match=r"step 1, clean: .*no\.usda: no such file") as refused:
        submit(SubmitSpec(job=job, write_only=True))
    assert "step 2" not in str(refused.value)
    assert [path.name for path in tmp_path.iterdir()] == ["job.yaml"]


def test_tasks_are_specs_that_run_from_anywhere(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("in.usda").write_text("#usda 1.0\n")
    Path("job.yaml").write_text("{step: clean, take: ./x/../in.usda, out: out.usda}")
    done = submit(SubmitSpec(job=Path("job.yaml"), write_only=True, out=Path("b")))
    text = (done.bundle / "template.yaml").read_text()
    assert text.startswith(FIRST_LINE)
    (task,) = read_job(done.bundle / "tasks" / "clean" / "1.yaml").steps
    assert task.take == tmp_path.resolve() / "in.usda"


def test_a_job_that_leaves_the_folder_it_is_confined_to_is_not_submitted(
    tmp_path: Path, monkeypatch
) -> None:
    shows = tmp_path / "shows"
    shows.mkdir()
    (tmp_path / "secret.usda").write_text("#usda 1.0\n")
    (shows / "link").symlink_to(tmp_path)
    monkeypatch.setenv("USDFACE_ROOT", str(shows))
    for take in ("../secret.usda", "link/secret.usda", str(tmp_path / "secret.usda")):
        job = shows / "job.yaml"
        job.write_text(yaml.safe_dump({"step": "clean", "take": take, "out": "out.usda"}))
        with pytest.raises(InputError, match="lies outside"):
            submit(SubmitSpec(job=job, write_only=True))
    assert sorted(path.name for path in shows.iterdir()) == ["job.yaml", "link"]


def test_nothing_outside_the_folder_of_confinement_is_carried_to_a_farm_nor_written(
    tmp_path: Path, monkeypatch
) -> None:
    shows = tmp_path / "shows"
    shows.mkdir()
    monkeypatch.setenv("USDFACE_ROOT", str(shows))
    (tmp_path / "secret.png").write_bytes(b"texture")
    take = """#usda 1.0
def "Take"
{
    asset inputs:file = @../secret.png@
}
"""
    (shows / "take.usda").write_text(take)
    text = yaml.safe_dump({"step": "clean", "take": "take.usda", "out": "out.usda"})
    (shows / "job.yaml").write_text(text)
    job = shows / "job.yaml"
    with pytest.raises(InputError, match=r"refers to .*secret\.png, which lies outside"):
        submit(SubmitSpec(job=job, write_only=True))
    (shows / "take.usda").write_text('#usda 1.0\ndef "Take" {}\n')
    with pytest.raises(InputError, match=r"bundle: lies outside"):
        submit(SubmitSpec(job=job, write_only=True, out=tmp_path / "my.bundle"))
    outside = tmp_path / "job.yaml"
    outside.write_text(text.replace("take.usda", "shows/take.usda").replace("out: ", "out: shows/"))
    with pytest.raises(InputError, match=r"job\.yaml: lies outside"):
        submit(SubmitSpec(job=outside, write_only=True, out=shows / "my.bundle"))
    assert sorted(path.name for path in shows.iterdir()) == ["job.yaml", "take.usda"]
    assert submit(SubmitSpec(job=job, write_only=True)).bundle.is_dir()
