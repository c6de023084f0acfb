"""Jobs changed at random are read or refused: no other error escapes."""

import copy
import datetime
import math
import os
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from usdface.core.errors import InputError
from usdface.specs.job import STEP_SPECS
from usdface.specs.reading import read_job

COUNT = int(os.environ.get("USDFACE_MUTATED_JOBS", "75"))
JOB: dict[str, Any] = {
    "job": "day",
    "takes": ["a", {"take": "b", "neutral": 88}],
    "steps": [
        {
            "for_each": "take",
            "steps": [
                {"step": "ingest", "sources": ["{take}.c3d"], "out": "{take}.take.usda"},
                {"step": "clean", "take": "{take}.take.usda", "out": "{take}.clean.take.usda"},
            ],
        },
        {
            "step": "select",
            "takes": ["{take}.clean.take.usda"],
            "rig": "hero.usd",
            "count": 60,
            "out": "hero.references.usda",
        },
    ],
}
ODD: list[Any] = [
    None, True, 0, -1, 5, 1e308, -1e-320, 10**400, math.nan, math.inf, "", "\0", "a\nb",
    "../" * 50, "~/x", "{{Param.X}}", "{take}", "$(id)", "x" * 300_000, [], {}, [[]] * 3,
    {"a": {"b": 1}}, {1: 2}, {None: None}, b"\xff", "\U0001f600", "-rf", ".", "..", "/", "a/",
    "1-0", "5--3", "9" * 40 + "-" + "9" * 42, "0x10", "1_0", "1e3", [None],
    datetime.date(1, 1, 1), datetime.datetime(9999, 12, 31),
]  # fmt: skip
TEXTS = (
    "&a ", "*a", "!!python/object/apply:os.system [id]", "!!binary ", "? ", "- - - ", "\t",
    "%YAML 9\n---\n", "{", '"', "\x85", "<<: *a\n", "!!timestamp 2001-99-99", "!!int 0b9",
    "!!float .", "!!set {a,b}", "!!omap [a: 1]",
)  # fmt: skip


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    for key in (
        data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()
    ):
        yield from places(data[key], (*path, key))


def mutated(rng: random.Random) -> str:
    job = copy.deepcopy(JOB)
    if rng.random() < 0.5:
        spec = rng.choice(STEP_SPECS)
        values = [*ODD, "x.usda", "o.png", "1-10", 0.5, ["x.usda"], ["a", "b"]]
        step = {name: rng.choice(values) for name in spec.model_fields if rng.random() < 0.8}
        job["steps"].append({**step, "step": spec.step_name()})
    for _ in range(rng.choice([1, 1, 2, 3])):
        path = rng.choice(list(places(job)))
        owner = job
        for key in path[:-1]:
            owner = owner[key]
        if rng.random() < 0.8:
            owner[path[-1]] = copy.deepcopy(rng.choice(ODD))
        else:
            del owner[path[-1]]
        if not job:
            break
    text = yaml.dump(job, allow_unicode=True)
    if rng.random() < 0.2:
        at = rng.randrange(len(text))
        text = text[:at] + rng.choice(TEXTS) + text[at:]
    return text


def test_a_job_with_anything_in_it_is_read_or_refused(tmp_path: Path) -> None:
    rng = random.Random(11)
    file = tmp_path / "day.job.yaml"
    read, refused = 0, list[str]()
    for _ in range(COUNT):
        file.write_text(mutated(rng), encoding="utf-8", errors="surrogatepass")
        try:
            read_job(file)
            read += 1
        except InputError as error:
            refused.append(str(error))
    raw = ("Input should", "<unicode string>", "Extra inputs", "valid tuple", "Field required")
    assert [each for each in refused if any(words in each for words in raw)] == []
    assert 0 < read < COUNT / 2


def test_steps_that_are_no_list_are_refused_beside_takes(tmp_path: Path) -> None:
    file = tmp_path / "day.job.yaml"
    for steps in ("5", "{a: 1}", "x", "[{for_each: take, steps: 5}]", "[null]"):
        file.write_text(f"{{job: day, takes: [a], steps: {steps}}}")
        try:
            read_job(file)
        except InputError:
            continue
        raise AssertionError(steps)
