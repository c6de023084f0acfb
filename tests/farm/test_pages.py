"""What the pages on farm and publish say can be typed as it stands."""

import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from tests.regenerate import REPOSITORY
from tests.steps.small_shot import Shot
from tests.test_docs import commands
from usdface.cli import main
from usdface.farm import submit as farm
from usdface.specs.job import JobSpec

DOCS = REPOSITORY / "docs"


@pytest.fixture
def handed_over(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Farms that only remember what they are given; test_farms.py hands over for real."""
    done: list[str] = []
    monkeypatch.setattr(farm, "run_bundle", lambda bundle, **options: done.append("openjd"))
    monkeypatch.setattr(farm, "submit_bundle", lambda bundle, **options: done.append("deadline"))
    monkeypatch.setattr(farm, "build_outline", lambda *given, **options: SimpleNamespace())
    monkeypatch.setattr(farm, "submit_outline", lambda launcher: done.append("opencue"))
    return done


@pytest.mark.parametrize("page", ["farm.md", "publish.md"])
def test_every_command_of_the_page_runs(page: str, shot: Shot, monkeypatch, handed_over) -> None:
    monkeypatch.chdir(shot.folder)
    lines = commands(DOCS / page)
    assert lines
    for line in lines:
        with pytest.raises(SystemExit, match="0"):
            main(shlex.split(line)[1:])
    assert handed_over == (["openjd", "deadline", "opencue"] if page == "farm.md" else [])


def test_the_job_of_many_takes_is_one() -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", (DOCS / "farm.md").read_text(), flags=re.DOTALL)
    job = JobSpec.model_validate(yaml.safe_load(text))
    assert [step.step for step in job.steps] == ["ingest", "clean", "ingest", "clean", "select"]


def test_the_files_that_the_publish_page_names_are_there() -> None:
    text = (DOCS / "publish.md").read_text(encoding="utf-8")
    # in the wheel, under the variable that the environment file sets, and beside the package
    named = set(re.findall(r"(?:usdface/hooks|\$USDFACE_HOOKS|\)/hooks)/([\w./-]+)", text))
    assert len(named) > 4
    for place in named:
        path: Path = REPOSITORY / "hooks" / place.rstrip(".")
        assert path.exists(), place
