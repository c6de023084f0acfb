"""The pages that guard and the pages per task: what they name is there, what they show runs."""

import re
import shlex
from pathlib import Path

import pytest

from tests.regenerate import REFERENCE, REPOSITORY
from tests.test_docs import commands, run

DOCS = REPOSITORY / "docs"


def test_every_test_that_the_security_page_names_is_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (DOCS / "security.md").read_text("utf-8"))
    assert len(named) > 40
    for file, test in named:
        assert f"def {test}(" in (REPOSITORY / file).read_text("utf-8"), f"{file}::{test}"


def test_every_variable_that_the_code_reads_is_on_the_security_page() -> None:
    page = (DOCS / "security.md").read_text("utf-8")
    for folder in ("pipeline", "hooks"):
        for file in (REPOSITORY / folder).rglob("*.py"):
            text = file.read_text("utf-8")
            for name in re.findall(r'environ(?:\.get\(|\.setdefault\(|\[)"(\w+)"', text):
                assert f"`{name}`" in page, f"{file.name} reads {name}"


HOW_TO = sorted((DOCS / "howto").glob("*.md"))
NO_SPEC = ("check", "describe", "edits list", "run", "submit", "tune", "validate")
"""Commands that `--save-spec` cannot try: their options are looked up."""


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_every_command_of_a_how_to_page_is_understood(
    page: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = commands(page)
    assert lines or page.stem == "README"
    for line in lines:
        name = next((each for each in NO_SPEC if line.startswith(f"usdface {each} ")), None)
        if name is None:
            assert run(f"{line} --save-spec spec.yaml") == 0, f"{line}\n{capsys.readouterr()}"
        else:
            _, _, section = (
                (REFERENCE / "command-line.md")
                .read_text("utf-8")
                .partition(f"\n## usdface {name}\n")
            )
            known = section.partition("\n## ")[0]
            for word in shlex.split(line):
                assert not word.startswith("--") or f"`{word}`" in known, f"{line}: {word}"


def test_every_how_to_page_is_listed_and_no_other() -> None:
    listed = re.findall(r"\]\((\w+\.md)\)", (DOCS / "howto" / "README.md").read_text("utf-8"))
    assert sorted(listed) == [page.name for page in HOW_TO if page.stem != "README"]


def test_every_page_is_in_the_index() -> None:
    linked = set(re.findall(r"\]\(([\w/.-]+\.md)\)", (DOCS / "README.md").read_text("utf-8")))
    pages = {page.name for page in DOCS.glob("*.md")} - {"README.md"}
    folders = {page.relative_to(DOCS).as_posix() for page in DOCS.glob("*/README.md")}
    assert pages | folders <= linked
