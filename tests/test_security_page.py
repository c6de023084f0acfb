"""The page of ways in names every command and every hook."""

import re

from tests.regenerate import REPOSITORY
from usdface.cli.app import make_app

PAGE = (REPOSITORY / "docs" / "security.md").read_text("utf-8")


def every_command() -> set[str]:
    found = set()
    for name, command in make_app().commands.items():
        below = getattr(command, "commands", None)
        found |= {f"{name} {each}" for each in below} if below else {name}
    return found


def test_every_command_is_said_to_read_something_and_no_other_is() -> None:
    table = PAGE.partition("## Who reads what")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]+) \|", table, flags=re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`([^`]+)`", row)} == every_command()


def test_every_hook_is_there() -> None:
    hooks = [each for each in (REPOSITORY / "hooks").iterdir() if each.suffix != ".md"]
    assert len(hooks) > 5
    for hook in hooks:
        assert f"`hooks/{hook.name}`" in PAGE
