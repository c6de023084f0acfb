"""Keys that are unknown or removed, in a file, a script and on the command line."""

from pathlib import Path

import pytest

import usdface
from usdface.cli import main
from usdface.core.errors import InputError
from usdface.specs.capture import CleanSpec
from usdface.specs.reading import read_job


@pytest.fixture(autouse=True)
def older_clean_spec(monkeypatch) -> None:
    """Give the clean step a history: `gpu` went, and a value of `rigid`."""
    removed = {"gpu": "it runs on the processor; leave it out", "max_gap=7": "use 8"}
    monkeypatch.setattr(CleanSpec, "removed", removed)


def job(folder: Path, keys: str) -> Path:
    file = folder / "shot.job.yaml"
    file.write_text(f"{{step: clean, take: a.usda, out: b.usda, {keys}}}", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("gpu: true", r"clean -> gpu: gpu was removed from clean; it runs on the processor; leave"),
        ("max_gap: 7", r"clean: max_gap 7 was removed from clean; use 8"),
        ("maxgap: 7", r"clean -> maxgap: unknown key; did you mean max_gap\?$"),
        ("zzz: 7", r"clean -> zzz: unknown key; it can be take, out, rigid, "),
    ],
)
def test_a_key_that_cannot_be_taken_is_refused_with_advice(tmp_path, keys, message) -> None:
    with pytest.raises(InputError, match=message):
        read_job(job(tmp_path, keys))


def test_a_script_is_told_the_same() -> None:
    with pytest.raises(InputError, match=r"^gpu: gpu was removed from clean; it runs on"):
        usdface.run_step("clean", take="a.usda", out="b.usda", gpu=True)
    with pytest.raises(InputError, match=r"^max_gap 7 was removed from clean; use 8"):
        usdface.run_step("clean", take="a.usda", out="b.usda", max_gap=7)
    with pytest.raises(InputError, match=r"^maxgap: unknown key; did you mean max_gap\?$"):
        usdface.run_step("clean", take="a.usda", out="b.usda", maxgap=7)


@pytest.mark.parametrize("given", [["--gpu"], ["--no-gpu"], ["--gpu=1"], ["--gpu", "1"]])
def test_an_option_that_is_gone_is_refused_with_advice(given, capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["clean", *given])
    assert stopped.value.code == 2
    assert "gpu was removed from clean; it runs on the processor" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "advice"),
    [
        (["sheet", "--pick", "confidence"], "pick confidence was removed from sheet; use uncert"),
        (["sheet", "--pick=confidence"], "pick confidence was removed from sheet; use uncertainty"),
        (["select", "--method", "active"], "method active was removed from select; it chose no"),
    ],
)
def test_a_value_that_is_gone_is_refused_with_the_one_to_use(given, advice, capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(given)
    assert stopped.value.code == 2
    assert advice in capsys.readouterr().err
