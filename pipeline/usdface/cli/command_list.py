"""Command groups: commands built on demand, listed in sections, interrupted by Ctrl+C."""

from collections import UserDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from usdface.cli.console import INTERRUPTED_MESSAGE
from usdface.cli.spec_options import refuse_removed_options
from usdface.core.errors import CancelledError

EPILOG = "Exit codes: 0 done, 1 a check failed, 2 bad input, 3 interrupted."

HEADINGS = {
    "capture": "Capture",
    "references": "References",
    "performance": "Performance",
    "edits": "Edits and publish",
    "review": "Review",
    "retarget": "Retargeting",
    "surface": "Meshes without shapes",
    "jobs": "Jobs",
}
"""Headings of the list of commands by workflow, which is a command's `rich_help_panel`."""

SUMMARY_LENGTH = 500
"""Largest length of a summary in characters; click would cut it to one line."""


@dataclass(frozen=True)
class CommandMaker:
    """A command that is created on first use, with its help for lists."""

    make: Callable[[], Any]
    """Returns the function of the command, or a Typer with the commands of a group."""
    help: str
    """The first sentence is the summary."""
    workflow: str | None
    """Key of `HEADINGS`; None in a group without sections."""

    def listed(self, name: str) -> Any:
        """Return a command that can only be listed."""
        return TyperCommand(name, help=self.help, rich_help_panel=self.workflow)


# Types below are click's or, depending on Typer's version, those of its private copy of click.
class CommandList(TyperGroup):
    """A group whose help lists commands by section, in the order of the workflow."""

    on_demand: ClassVar[Mapping[str, CommandMaker]] = {}

    def __init__(self, **settings: Any) -> None:
        commands = _MadeOnDemand({**self.on_demand, **(settings.pop("commands", None) or {})})
        super().__init__(**settings)
        self.commands = commands

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; refuse removed options with advice."""
        name, command, rest = super().resolve_command(ctx, args)
        spec = getattr(getattr(command, "callback", None), "spec", None)
        if spec is not None:
            refuse_removed_options(spec, rest)
        return name, command, rest

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl+C raises CancelledError, where Typer would exit without a message."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise CancelledError(INTERRUPTED_MESSAGE) from interrupt

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands; Typer's method would create all of them."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write name and summary of every command, under headings if the group has any."""
        sections: dict[str, dict[str, str]] = {} if ctx.parent else {key: {} for key in HEADINGS}
        width = max(map(len, self.list_commands(ctx)), default=0)
        for name in self.list_commands(ctx):
            waiting = self.on_demand.get(name)
            command = self.get_command(ctx, name) if waiting is None else waiting.listed(name)
            if command is not None and not command.hidden:
                workflow = "" if ctx.parent else getattr(command, "rich_help_panel", "")
                summary = command.get_short_help_str(SUMMARY_LENGTH)
                sections[workflow] = sections.get(workflow, {}) | {name.ljust(width): summary}
        for workflow, summaries in sections.items():
            if summaries:
                with formatter.section(HEADINGS.get(workflow, "Commands")):
                    formatter.write_dl(list(summaries.items()))


class _MadeOnDemand(UserDict[str, Any]):
    """Commands by name, or their makers until they are used."""

    def __getitem__(self, name: str) -> Any:
        command = self.data[name]
        if isinstance(command, CommandMaker):
            command = self.data[name] = _command(name, command.make)
        return command


def commands_on_demand(makers: Mapping[str, CommandMaker]) -> Any:
    """Return a group class whose commands are created on demand, 0.08 s sooner than all."""
    return type("CommandList", (CommandList,), {"on_demand": makers})


def _command(name: str, make: Callable[[], Any]) -> Any:
    """Create the click command or group of a function or Typer."""
    made = make()
    if isinstance(made, typer.Typer):
        return typer.main.get_group(made)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    panel = made.spec.workflow() if hasattr(made, "spec") else None
    alone.command(name, epilog=EPILOG, rich_help_panel=panel)(made)
    return typer.main.get_command(alone)
