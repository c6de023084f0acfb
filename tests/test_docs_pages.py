"""The pages that guard and the pages per task: what they name is there, what they show runs."""

import re

from tests.regenerate import REPOSITORY

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
