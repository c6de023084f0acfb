"""A job says once what it does with many takes."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from usdface.core.errors import InputError
from usdface.specs.job import JobSpec
from usdface.specs.reading import read_job, spec_text
from usdface.specs.takes import write_out

LOOP = {
    "for_each": "take",
    "steps": [
        {
            "step": "ingest",
            "sources": ["{take}.c3d"],
            "out": "{take}.take.usda",
            "neutral": "{neutral}",
        },
        {"step": "clean", "take": "{take}.take.usda", "out": "{take}.clean.take.usda"},
    ],
}
SELECT = {
    "step": "select",
    "takes": ["{take}.clean.take.usda"],
    "rig": "hero.usd",
    "out": "hero.references.usda",
}


def job(**changes: object) -> dict[str, object]:
    data = {
        "job": "day",
        "takes": [{"take": "a", "neutral": 3}, {"take": "b", "neutral": 40}],
        "steps": [LOOP, SELECT],
    }
    return data | changes


def test_a_loop_is_the_job_written_out_by_hand() -> None:
    by_hand = {
        "job": "day",
        "steps": [
            {"step": "ingest", "sources": ["a.c3d"], "out": "a.take.usda", "neutral": 3},
            {"step": "clean", "take": "a.take.usda", "out": "a.clean.take.usda"},
            {"step": "ingest", "sources": ["b.c3d"], "out": "b.take.usda", "neutral": 40},
            {"step": "clean", "take": "b.take.usda", "out": "b.clean.take.usda"},
            {
                "step": "select",
                "takes": ["a.clean.take.usda", "b.clean.take.usda"],
                "rig": "hero.usd",
                "out": "hero.references.usda",
            },
        ],
    }
    assert JobSpec.model_validate(job()) == JobSpec.model_validate(by_hand)


def test_twenty_takes_are_a_list_of_names(tmp_path: Path) -> None:
    takes = [f"kitchen_{number:03}" for number in range(20)]
    loop = {"for_each": "take", "steps": [LOOP["steps"][1]]}
    file = tmp_path / "day.job.yaml"
    file.write_text(yaml.safe_dump({"job": "day", "takes": takes, "steps": [loop]}))
    steps = read_job(file).steps
    assert [step.out.name for step in steps] == [f"{take}.clean.take.usda" for take in takes]


def test_a_job_written_out_reads_back_the_same(tmp_path: Path) -> None:
    spec = JobSpec.model_validate(job())
    file = tmp_path / "out.yaml"
    text = spec_text(spec, file)
    assert "takes" not in yaml.safe_load(text)
    assert JobSpec.model_validate(yaml.safe_load(text)) == spec


def test_a_job_without_takes_keeps_its_braces() -> None:
    steps = [{"step": "clean", "take": "{take}.usda", "out": "{{x}}.usda"}]
    spec = JobSpec.model_validate({"job": "braces", "steps": steps})
    assert spec.steps[0].take == Path("{take}.usda")
    assert spec.steps[0].out == Path("{{x}}.usda")


def test_doubled_braces_are_plain_ones() -> None:
    steps = [{"step": "clean", "take": "{{take}}.usda", "out": "x{{}}.usda"}]
    spec = JobSpec.model_validate({"job": "braces", "takes": ["a"], "steps": steps})
    assert spec.steps[0].take == Path("{take}.usda")
    assert spec.steps[0].out == Path("x{}.usda")


@settings(deadline=None)  # a busy machine is no fault
@given(
    st.text(min_size=1, max_size=30).filter(lambda s: not set(s) & set("/\\") and s.isprintable())
)
def test_what_a_take_is_called_is_never_read_as_a_place(name: str) -> None:
    if name in (".", ".."):
        return
    steps = [{"for_each": "take", "steps": [{"step": "x", "out": "<{take}>"}]}]
    written = write_out({"job": "j", "takes": [name], "steps": steps})
    assert written["steps"] == [{"step": "x", "out": f"<{name}>"}]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"takes": []}, "takes must be a list"),
        ({"takes": "a"}, "takes must be a list"),
        ({"takes": [{"name": "a"}]}, r"take 1: must be a name, or a table with its name"),
        ({"takes": ["a", "a"]}, r"take 2: 'a' is a duplicate"),
        ({"takes": ["../../etc/passwd"]}, "cannot name a take"),
        ({"takes": [".."]}, "cannot name a take"),
        ({"takes": ["a\nopenjd_fail: x"]}, "cannot name a take"),
        ({"takes": [{"take": "a", "neutral": [1]}]}, "'neutral' must be a text or a number"),
        ({"takes": ["a"]}, r"step 1: uses \{neutral\}, but take 'a' has only take"),
        ({"takes": None}, "needs `takes`"),
        ({"steps": [{"for_each": "hero", "steps": []}]}, "can only be `take`"),
        ({"steps": [{"for_each": "take", "step": "x"}]}, "for_each allows only `steps`"),
        ({"steps": [{"for_each": "take", "steps": []}]}, "for_each needs `steps`"),
        (
            {"steps": [{"step": "clean", "take": "{take}.usda", "out": "x.usda"}]},
            r"step 1: '\{take\}.usda' differs between takes",
        ),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_table_that_is_not_in_order_is_refused(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    file = tmp_path / "day.job.yaml"
    file.write_text(yaml.safe_dump(job(**changes)))
    with pytest.raises(InputError, match=message):
        read_job(file)


@pytest.mark.parametrize("takes", ["takes: [a]", "# no takes"])
@pytest.mark.parametrize(
    "steps", ["*x9", "[*x9]", "[{step: *x9}]", "[{step: train, references: *x9, method: *x9}]"]
)
def test_aliases_that_stand_for_billions_of_values_are_refused(
    tmp_path: Path, takes: str, steps: str
) -> None:
    lines = ["job: bomb", takes, "x0: &x0 [" + ",".join("a" * 10) + "]"]
    for level in range(1, 10):
        lines.append(f"x{level}: &x{level} [" + ", ".join([f"*x{level - 1}"] * 10) + "]")
    file = tmp_path / "bomb.yaml"
    file.write_text("\n".join([*lines, f"steps: {steps}"]))
    with pytest.raises(InputError, match="more than 1000000 values"):
        read_job(file)


def test_merged_tables_that_stand_for_billions_of_keys_are_refused(tmp_path: Path) -> None:
    lines = ["job: bomb", "steps: []", "x0: &x0 {a: 1, b: 2}"]
    for level in range(1, 12):
        lines.append(f"x{level}: &x{level} {{<<: [" + ", ".join([f"*x{level - 1}"] * 10) + "]}")
    file = tmp_path / "bomb.yaml"
    file.write_text("\n".join(lines))
    with pytest.raises(InputError, match="more than 1000000 values"):
        read_job(file)


def test_a_list_that_holds_itself_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "loop.yaml"
    file.write_text("job: loop\ntakes: [a]\nsteps: &a [*a]\n")
    with pytest.raises(InputError, match="more than 1000000 values"):
        read_job(file)


def test_what_is_wrong_in_a_loop_is_named_once_where_it_stands(tmp_path: Path) -> None:
    loop = {**LOOP, "steps": [LOOP["steps"][0], {"step": "clean", "out": "{take}.clean.take.usda"}]}
    path = tmp_path / "day.job.yaml"
    path.write_text(yaml.safe_dump(job(steps=[loop, {**SELECT, "count": -1}])), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_job(path)
    first, second = str(refused.value).splitlines()[1:]
    assert first == "  step 1.2, clean -> take: is missing; give it"
    assert second.startswith("  step 2, select -> count: ")
