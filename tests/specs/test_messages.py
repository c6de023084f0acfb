"""Keys that are unknown, in a file and in a script."""

from pathlib import Path

import pytest

import usdface
from usdface.core.errors import InputError
from usdface.specs.reading import read_job


def job(folder: Path, keys: str) -> Path:
    file = folder / "shot.job.yaml"
    file.write_text(f"{{step: clean, take: a.usda, out: b.usda, {keys}}}", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("maxgap: 7", r"clean -> maxgap: unknown key; did you mean max_gap\?$"),
        ("zzz: 7", r"clean -> zzz: unknown key; it can be take, out, rigid, "),
    ],
)
def test_a_key_that_cannot_be_taken_is_refused_with_advice(tmp_path, keys, message) -> None:
    with pytest.raises(InputError, match=message):
        read_job(job(tmp_path, keys))


def test_a_script_is_told_the_same() -> None:
    with pytest.raises(InputError, match=r"^maxgap: unknown key; did you mean max_gap\?$"):
        usdface.run_step("clean", take="a.usda", out="b.usda", maxgap=7)
