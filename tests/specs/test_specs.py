"""Specs: what is accepted, what is refused, and with which words."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

import usdface
from tests.regenerate import JSON_SCHEMAS, json_schemas
from usdface.cli.spec_options import build_spec
from usdface.core.errors import InputError
from usdface.core.sidecars import tuned_path
from usdface.specs.base import Spec, field_help
from usdface.specs.capture import CleanSpec
from usdface.specs.edits import EditSpec
from usdface.specs.job import STEP_SPECS, JobSpec
from usdface.specs.paths import Reads, Writes, frame_range
from usdface.specs.performance import MapSpec
from usdface.specs.reading import PATTERN_WORDS, read_job, spec_text
from usdface.specs.retarget import CyclicSpec
from usdface.specs.review import MovieSpec, SheetSpec

JOB = """
job: kitchen_talk_v003
steps:
  - {step: ingest, sources: [kitchen.c3d], video: kitchen.mov, out: kitchen.take.usda}
  - {step: clean, take: kitchen.take.usda, out: kitchen.clean.take.usda}
  - {step: select, takes: [kitchen.clean.take.usda], rig: hero.usd, count: 50, out: hero.references.usda}
  - {step: references-import, references: hero.references.usda, weights: tuned.csv}
  - {step: train, references: hero.references.usda, out: hero.mapping.usdc}
  - {step: map, take: kitchen.clean.take.usda, mapping: hero.mapping.usdc, rig: hero.usd, out: kitchen.hero.usda}
  - {step: sheet, performance: kitchen.hero.usda, take: kitchen.clean.take.usda, out: kitchen.sheet.jpg}
"""  # noqa: E501


def write(folder: Path, text: str, name: str = "kitchen.job.yaml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_a_job_reads_with_its_paths_beside_it(tmp_path: Path) -> None:
    job = read_job(write(tmp_path, JOB))
    assert [step.step for step in job.steps] == [
        "ingest",
        "clean",
        "select",
        "references-import",
        "train",
        "map",
        "sheet",
    ]
    for step in job.steps:
        for path in (*step.paths(Reads), *step.paths(Writes), *step.outputs()):
            assert path.parent == tmp_path
    assert job.steps[0].paths(Reads) == (tmp_path / "kitchen.c3d", tmp_path / "kitchen.mov")
    assert job.steps[3].outputs() == (tuned_path(tmp_path / "hero.references.usda"),)


def test_a_single_step_is_a_job_of_one(tmp_path: Path) -> None:
    job = read_job(
        write(tmp_path, '{"step": "clean", "take": "a.usda", "out": "b.usda"}', "c.json")
    )
    assert job.job == "c"
    assert job.steps[0].step == "clean"


@pytest.mark.parametrize("name", ["job.yaml", "job.json"])
@pytest.mark.parametrize("index", range(7))
def test_a_saved_spec_reads_back_the_same(tmp_path: Path, name: str, index: int) -> None:
    spec = JobSpec.model_validate(yaml.safe_load(JOB)).steps[index]
    path = write(tmp_path, spec_text(spec, Path(name)), name)
    assert read_job(path).steps == (spec.with_paths(lambda each: tmp_path / each),)


def test_a_spec_saved_by_a_link_to_a_folder_names_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    monkeypatch.chdir(tmp_path)
    spec = CleanSpec(take=Path("a.usda"), out=Path("b.usda"))
    saved = write(Path("link"), spec_text(spec.relative_to(Path("link")), Path("s.yaml")), "s.yaml")
    (read,) = read_job(saved).steps
    assert [each.resolve() for each in read.paths(Reads)] == [tmp_path.resolve() / "a.usda"]


def test_a_layer_has_an_ending_in_small_letters() -> None:
    with pytest.raises(ValidationError, match=r"must end in \.usda, \.usdc, \.usd"):
        CleanSpec(take=Path("a.usda"), out=Path("b.USDA"))


def test_a_saved_job_reads_back_the_same(tmp_path: Path) -> None:
    job = JobSpec.model_validate(yaml.safe_load(JOB))
    path = write(tmp_path, spec_text(job, Path("j.yaml")))
    anchored = (step.with_paths(lambda each: tmp_path / each) for step in job.steps)
    assert read_job(path).steps == tuple(anchored)


@pytest.mark.parametrize("text", ["{job: a, job: b, steps: []}", '{"job": "a", "job": "b"}'])
def test_a_key_given_twice_is_refused_with_its_place(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"line 1, column \d+: job is given twice in one table"):
        read_job(write(tmp_path, text))


def test_json_may_have_tabs_and_escaped_characters_beyond_16_bits(tmp_path: Path) -> None:
    step = {"step": "clean", "take": "a\U0001f600.usda", "out": "b.usda"}
    text = json.dumps({"job": "\U0001f600", "steps": [step]}, indent="\t")
    job = read_job(write(tmp_path, "\ufeff" + text, "c.json"))
    assert "\\ud83d" in text
    assert (job.job, job.steps[0].paths(Reads)) == ("\U0001f600", (tmp_path / step["take"],))


@pytest.mark.parametrize(
    ("number", "base"), [("0120", 8), ("-077", 8), ("0_7", 8), ("1:20", 60), ("1:20.5", 60)]
)
def test_a_number_that_yaml_reads_with_another_base_is_refused(
    tmp_path: Path, number: str, base: int
) -> None:
    text = f"job: a\nsteps: [{{step: clean, take: a.usda, out: b.usda, neutral: {number}}}]\n"
    with pytest.raises(
        InputError, match=rf"line 2, column \d+: YAML reads {number} with base {base}"
    ):
        read_job(write(tmp_path, text))


def test_a_word_that_yaml_reads_as_a_boolean_needs_quotes(tmp_path: Path) -> None:
    quote = "quote a name that YAML reads as a number, a date, true or false"
    for option, told in (
        ("mirrored: no", "mirrored: it can be labels, axes, no; in quotes, as"),
        ("performer: no", f"performer: give a text; {quote}"),
        ("video: 1.10", f"video: give the path of a file; {quote}"),
    ):
        text = f"{{step: ingest, sources: [a.c3d], out: b.usda, {option}}}"
        with pytest.raises(InputError, match=told):
            read_job(write(tmp_path, text))
    steps = "[{for_each: take, steps: [{step: clean, take: a.usda, out: '{day}.usda'}]}]"
    for takes, told in (
        ("[no]", f"take 1: must be a name.*{quote}"),
        ("[{take: a, day: no}]", quote),
    ):
        with pytest.raises(InputError, match=told):
            read_job(write(tmp_path, f"{{job: a, takes: {takes}, steps: {steps}}}"))


def test_options_shared_by_steps_may_be_changed_for_one(tmp_path: Path) -> None:
    shared = "&a {step: clean, take: a.usda, out: b.usda, max_gap: 9}"
    text = f"{{job: a, steps: [{shared}, {{<<: *a, out: c.usda, max_gap: 8}}]}}"
    assert [each.max_gap for each in read_job(write(tmp_path, text)).steps] == [9, 8]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("count: 50", "count: 1"), r"step 3, select -> count: give 2 or more \(got 1\)"),
        (("step: train", "step: xyzzy"), r"^\S+: step 5: .*'xyzzy'; steps are ingest, track"),
        (
            ("step: train", "step: trian"),
            r"there is no step 'trian'; did you mean train or track\?$",
        ),
        (
            ("out: kitchen.take.usda", "oot: x"),
            r"step 1, ingest -> oot: unknown key; did you mean out\?$",
        ),
        (("sources: [kitchen.c3d]", "sources: []"), r"step 1, ingest -> sources: give 1 or more"),
        (("job: kitchen_talk_v003", "job: ''"), r"job: give 1 or more characters"),
        (("take: kitchen.take.usda, ", ""), r"step 2, clean -> take: is missing; give it"),
        (
            ("out: hero.mapping.usdc", "out: kitchen.take.usda"),
            r"steps 1 and 5 both write kitchen\.take\.usda",
        ),
        (
            ("take: kitchen.take.usda", "take: kitchen.hero.usda"),
            r"step 2 reads kitchen\.hero\.usda before step 6 writes it",
        ),
        (("out: kitchen.sheet.jpg", "out: sheet.usda"), r"sheet -> out: a picture is written"),
    ],
    ids=lambda value: value[1] if isinstance(value, tuple) else None,
)
def test_a_faulty_job_is_refused_with_the_field_named(tmp_path, change, message) -> None:
    with pytest.raises(InputError, match=message):
        read_job(write(tmp_path, JOB.replace(*change)))


def patterns(schema: object) -> Iterator[str]:
    if isinstance(schema, dict):
        if isinstance(schema.get("pattern"), str):
            yield schema["pattern"]
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from patterns(part)


def test_every_pattern_of_a_spec_has_words_and_none_is_shown() -> None:
    schemas = [spec.model_json_schema() for spec in STEP_SPECS]
    assert {found for schema in schemas for found in patterns(schema)} == set(PATTERN_WORDS)
    with pytest.raises(InputError, match=r"frames: give the first .* 101-240 \(got '12'\)$"):
        usdface.run_step("edit", performance="a.usda", shape=["jawOpen"], add=0.1, frames="12")
    with pytest.raises(InputError, match=r"out: a USD layer .* \(got 'a.txt'\)$"):
        usdface.run_step("clean", take="a.usda", out="a.txt")


def test_every_fault_is_told_at_once(tmp_path: Path) -> None:
    text = JOB.replace("count: 50", "count: 1").replace("sources: [kitchen.c3d]", "sources: []")
    with pytest.raises(InputError, match=r"2 faults\n.*sources.*\n.*count"):
        read_job(write(tmp_path, text))


@pytest.mark.parametrize(
    ("spec", "given", "message"),
    [
        (EditSpec, {"add": 0.1, "shape": ["a"], "frames": "1-9999999999"}, "frame 9999999999 is"),
        (SheetSpec, {"frames": "1,-9999999999", "out": "a.jpg"}, "frame -9999999999 is beyond"),
        (MovieSpec, {"rate": 1e-320, "out": "a.mp4"}, "rate: give 0.01 or more"),
    ],
)
def test_frames_and_rates_that_no_take_has_are_refused(
    spec: type[Spec], given: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        build_spec(spec, {"performance": "p.usda"} | given)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("methods", [""], "methods: give 1 or more"), ("every", 10**21, "every: give 1000000000")],
)
def test_a_round_trip_of_no_method_or_frame_is_refused(
    option: str, value: object, message: str
) -> None:
    given = {"pairs": "p.usda", "source": "s.usda", "out": ["a.json"]}
    with pytest.raises(InputError, match=message):
        build_spec(CyclicSpec, given | {option: value})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"job: [", r"no valid YAML or JSON"),
        (b"\xff\xfe\x00", r"is no YAML or JSON, as a job or spec is: not UTF-8 at byte 0"),
        (b"- 1\n- 2", r"holds list, not a job"),
        (b"", r"holds NoneType, not a job"),
        (b"job: !!python/object/apply:os.system ['true']", r"no valid YAML or JSON"),
        (b"[" * 1_000, r"nested too deeply|no valid YAML"),
    ],
    ids=["broken", "binary", "list", "empty", "code", "deep"],
)
def test_a_file_that_is_no_spec_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "job.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_job(path)


def test_a_missing_job_names_the_path(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.yaml: cannot be read"):
        read_job(tmp_path / "no.yaml")


@pytest.mark.parametrize(
    ("text", "expected"), [("1-240", (1, 240)), ("-5--2", (-5, -2)), ("-3-7", (-3, 7))]
)
def test_frame_ranges(text: str, expected: tuple[int, int]) -> None:
    assert frame_range(text) == expected


def test_specs_are_frozen() -> None:
    spec = MapSpec(take="a.usda", mapping="m.usda", rig="r.usda", out="o.usda")
    with pytest.raises(ValueError, match="frozen"):
        spec.out = Path("x")


def test_every_field_of_every_spec_is_documented() -> None:
    for spec in STEP_SPECS:
        assert spec.example.startswith("usdface ")
        for name in spec.model_fields:
            assert name == "step" or name in field_help(spec), f"{spec.__name__}.{name}"


def test_a_package_without_source_has_options_without_help(monkeypatch) -> None:
    def no_source(owner: type) -> str:
        raise OSError("could not get source code")

    monkeypatch.setattr("inspect.getsource", no_source)
    assert field_help.__wrapped__(MapSpec) == {}


def test_committed_json_schemas_are_those_of_the_models() -> None:
    schemas = json_schemas()
    assert {path.name for path in JSON_SCHEMAS.glob("*.json")} == set(schemas)
    for name, text in schemas.items():
        assert (JSON_SCHEMAS / name).read_text(encoding="utf-8") == text, "run `poe schemas`"


def test_a_name_that_no_layer_could_hold_is_refused() -> None:
    given = {"take": "a.usda", "mapping": "b.usdc", "rig": "hero.usd", "out": "c.usda"}
    for field in ("take", "out"):
        with pytest.raises(ValueError, match=r"'\\udcff\.usda' is not valid Unicode"):
            MapSpec.model_validate(given | {field: "\udcff.usda"})
