"""Every example in the documentation runs, and every link leads somewhere."""

import re
import shlex
from pathlib import Path

import pytest

from develop import main as develop
from tests.regenerate import REPOSITORY
from tests.steps.small_shot import make_inputs
from usdface.cli import main

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def commands(page: Path) -> list[str]:
    """The command lines in a page's shell blocks, comments left out."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split("  #")[0].strip() for line in lines if line.strip()]


def run(line: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(shlex.split(line)[1:])
    return int(stopped.value.code or 0)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_tutorial_runs_from_top_to_bottom(tmp_path: Path, monkeypatch, capsys) -> None:
    make_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    lines = commands(REPOSITORY / "docs" / "tutorial.md")
    assert len(lines) > 8
    for line in lines:
        # The job that the tutorial ends with was made with other options than its commands.
        extra = " --overwrite" if line.startswith("usdface run") else ""
        code = run(line + extra)
        assert code == 0, f"{line}\n{capsys.readouterr()}"
    assert (tmp_path / "map.yaml").is_file()
    assert (tmp_path / "shot.sheet.jpg").is_file()


def test_every_command_of_the_readme_is_understood(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for line in commands(REPOSITORY / "README.md"):
        words = shlex.split(line)
        if words[0] == "python3":
            monkeypatch.setattr("sys.argv", [words[1], "--help"])
            with pytest.raises(SystemExit, match="0"):
                develop()
            assert words[2] in capsys.readouterr().out
        elif words[1] in ("run", "check"):
            assert run(f"{words[0]} {words[1]} --help") == 0
        else:
            assert run(f"{line} --save-spec spec.yaml") == 0, line
            assert Path("spec.yaml").read_text(encoding="utf-8").startswith("step: ")


def test_examples_in_the_help_are_understood(tmp_path: Path, monkeypatch) -> None:
    from usdface.specs.job import STEP_SPECS

    monkeypatch.chdir(tmp_path)
    for spec in STEP_SPECS:
        assert run(f"{spec.example} --save-spec {spec.model_fields['step'].default}.yaml") == 0


def test_the_review_page_runs(shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    for line in commands(REPOSITORY / "docs" / "review.md"):
        command = line.split()[1]
        small = {"sheet": " --tile 64", "movie": " --height 64 --rate 12"}.get(command, "")
        code = run(f"{line}{small} --overwrite")
        assert code == 0, f"{line}\n{capsys.readouterr()}"
    assert (shot / "shot.review.mp4").is_file()


def test_every_command_of_the_references_page_is_understood(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = commands(REPOSITORY / "docs" / "references.md")
    assert len(lines) == 7
    for line in lines:
        assert run(f"{line} --save-spec spec.yaml") == 0, line
