"""A job written on one machine finds its files on another."""

import json
from pathlib import Path

import pytest

from usdface.core.errors import InputError
from usdface.specs.paths import map_path, read_path_rules
from usdface.specs.reading import read_job


def rules(tmp_path: Path, *given: tuple[str, str, str]) -> Path:
    keys = ("source_path_format", "source_path", "destination_path")
    document = {
        "version": "pathmapping-1.0",
        "path_mapping_rules": [dict(zip(keys, rule, strict=True)) for rule in given],
    }
    file = tmp_path / "rules.json"
    file.write_text(json.dumps(document))
    return file


def test_the_deepest_rule_wins_in_whatever_order_they_come(tmp_path: Path) -> None:
    found = read_path_rules(
        rules(tmp_path, ("POSIX", "/show", "/mnt/a"), ("POSIX", "/show/cache", "/fast"))
    )
    assert map_path(Path("/show/hero.usd"), found) == Path("/mnt/a/hero.usd")
    assert map_path(Path("/show/cache/x.usda"), found) == Path("/fast/x.usda")
    assert map_path(Path("/shows/x.usda"), found) == Path("/shows/x.usda")


def test_paths_of_windows_are_understood_here(tmp_path: Path) -> None:
    found = read_path_rules(rules(tmp_path, ("WINDOWS", "P:\\show", "/mnt/show")))
    assert map_path(Path("p:\\Show\\a b\\x.usda"), found) == Path("/mnt/show/a b/x.usda")
    assert map_path(Path("P:/show/x.usda"), found) == Path("/mnt/show/x.usda")


def test_a_job_is_read_with_its_paths_as_they_are_here(tmp_path: Path) -> None:
    job = tmp_path / "job.yaml"
    job.write_text("{step: clean, take: /show/x.usda, out: out.usda}")
    found = read_path_rules(rules(tmp_path, ("POSIX", "/show", "/mnt/show")))
    (step,) = read_job(job, path_rules=found).steps
    assert step.take == Path("/mnt/show/x.usda")
    assert step.out == tmp_path / "out.usda"


def test_no_rules_change_nothing(tmp_path: Path) -> None:
    file = tmp_path / "rules.json"
    file.write_text("{}")
    assert read_path_rules(file) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "holds list, not path mapping rules"),
        ("{", "no valid JSON"),
        ('{"version": "2"}', "version is '2'; only 'pathmapping-1.0'"),
        (
            '{"version": "pathmapping-1.0", "path_mapping_rules": [1]}',
            r"rules\[0\]: is 1, not a rule",
        ),
        (
            '{"version": "pathmapping-1.0", "path_mapping_rules": [{"source_path": "/"}]}',
            "needs source_path_format",
        ),
    ],
)
def test_what_is_no_rules_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "rules.json"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_path_rules(file)
