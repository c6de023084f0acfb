"""Keys that are unknown, renamed or removed, in a file, a script and on the command line."""

import logging
from pathlib import Path

import pytest

import usdface
from usdface.cli import main
from usdface.core.errors import InputError
from usdface.specs.base import warn_of_old_name
from usdface.specs.capture import CleanSpec
from usdface.specs.reading import read_job


@pytest.fixture(autouse=True)
def older_clean_spec(monkeypatch) -> None:
    """Give the clean step a history: `longest_gap` became `max_gap`, `gpu` went."""
    monkeypatch.setattr(CleanSpec, "renamed", {"longest_gap": "max_gap"})
    monkeypatch.setattr(CleanSpec, "removed", {"gpu": "it runs on the processor; leave it out"})
    warn_of_old_name.cache_clear()


def job(folder: Path, keys: str) -> Path:
    file = folder / "shot.job.yaml"
    file.write_text(f"{{step: clean, take: a.usda, out: b.usda, {keys}}}", encoding="utf-8")
    return file


def test_an_old_key_of_a_job_is_accepted_with_one_warning(tmp_path, caplog) -> None:
    with caplog.at_level(logging.WARNING):
        (step,) = read_job(job(tmp_path, "longest_gap: 7")).steps
        read_job(job(tmp_path, "longest_gap: 7"))
    assert step.max_gap == 7
    assert [record.getMessage() for record in caplog.records] == [
        "clean: longest_gap is now called max_gap; the old name is accepted in this version alone"
    ]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("longest_gap: 7, max_gap: 8", "longest_gap is now called max_gap, and both are given"),
        ("gpu: true", r"clean -> gpu: clean has no gpu any more; it runs on the processor; leave"),
        ("maxgap: 7", r"clean -> maxgap: unknown key; did you mean max_gap\?$"),
        ("zzz: 7", r"clean -> zzz: unknown key; it can be take, out, rigid, "),
    ],
)
def test_a_key_that_cannot_be_taken_is_refused_with_advice(tmp_path, keys, message) -> None:
    with pytest.raises(InputError, match=message):
        read_job(job(tmp_path, keys))


def test_a_script_is_told_the_same(caplog) -> None:
    with pytest.raises(InputError, match=r"^gpu: clean has no gpu any more; it runs on"):
        usdface.run_step("clean", take="a.usda", out="b.usda", gpu=True)
    with pytest.raises(InputError, match=r"^maxgap: unknown key; did you mean max_gap\?$"):
        usdface.run_step("clean", take="a.usda", out="b.usda", maxgap=7)


@pytest.mark.parametrize("given", [["--longest-gap", "7"], ["--longest-gap=7"]])
def test_an_old_option_is_accepted_with_a_warning(tmp_path, given, caplog) -> None:
    saved = tmp_path / "clean.yaml"
    with caplog.at_level(logging.WARNING), pytest.raises(SystemExit) as stopped:
        main(["clean", "a.usda", "--out", "b.usda", *given, "--save-spec", str(saved)])
    assert stopped.value.code == 0
    assert "max_gap: 7" in saved.read_text(encoding="utf-8")
    assert "clean: longest_gap is now called max_gap" in caplog.text


@pytest.mark.parametrize("given", [["--gpu"], ["--no-gpu"], ["--gpu=1"], ["--gpu", "1"]])
def test_an_option_that_is_gone_is_refused_with_advice(given, capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["clean", *given])
    assert stopped.value.code == 2
    assert "clean has no gpu any more; it runs on the processor" in capsys.readouterr().err
