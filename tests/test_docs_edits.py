"""The pages on edits and checks run from top to bottom."""

import pytest

from tests.regenerate import REPOSITORY
from tests.steps.small_shot import Shot
from tests.test_docs import commands, run


@pytest.mark.usefixtures("without_comparison", "placement_not_drawn", "coverage_not_drawn")
@pytest.mark.parametrize("page", ["edits", "checks"])
def test_the_page_runs(page: str, shot: Shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    lines = commands(REPOSITORY / "docs" / f"{page}.md")
    assert lines
    for line in lines:
        # Comparing the methods takes long, and is tested elsewhere.
        code = run(f"{line} --method face_map" if line.startswith("usdface train ") else line)
        assert code == 0, f"{line}\n{capsys.readouterr()}"
