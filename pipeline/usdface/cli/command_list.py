"""Command groups: commands built on demand, listed in sections, interrupted by Ctrl+C."""

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import Any, ClassVar

import typer
from typer.core import TyperGroup

from usdface.cli.console import STOPPED
from usdface.cli.spec_options import current_options
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
"""Headings of the list of commands, by workflow: the `rich_help_panel` of each command."""

SUMMARY_LENGTH = 500
"""Largest length of a summary in characters; click would cut it to one line."""


# Types below are click's or, depending on Typer's version, those of its private copy of click.
class CommandList(TyperGroup):
    """A group whose help lists commands by section, in the order of the workflow."""

    on_demand: ClassVar[Mapping[str, Callable[[], Any]]] = {}

    def __init__(self, **settings: Any) -> None:
        commands = _MadeOnDemand(self.on_demand, settings.pop("commands", None) or {})
        super().__init__(**settings)
        self.commands = commands

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command, and bring options that have been renamed up to date."""
        name, command, rest = super().resolve_command(ctx, args)
        spec = getattr(getattr(command, "callback", None), "spec", None)
        return name, command, rest if spec is None else current_options(spec, rest)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl+C ends it like SIGTERM.

        Typer would exit with 130 and without a message.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise CancelledError(STOPPED) from interrupt

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write name and summary of every command, under headings if the group has any."""
        sections: dict[str, dict[str, str]] = {} if ctx.parent else {key: {} for key in HEADINGS}
        width = max(map(len, self.list_commands(ctx)), default=0)
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                workflow = "" if ctx.parent else getattr(command, "rich_help_panel", "")
                summary = command.get_short_help_str(SUMMARY_LENGTH)
                sections[workflow] = sections.get(workflow, {}) | {name.ljust(width): summary}
        for workflow, summaries in sections.items():
            if summaries:
                with formatter.section(HEADINGS.get(workflow, "Commands")):
                    formatter.write_dl(list(summaries.items()))


class _MadeOnDemand(MutableMapping[str, Any]):
    """Commands by name; each is made when it is used."""

    def __init__(self, makers: Mapping[str, Callable[[], Any]], made: Mapping[str, Any]) -> None:
        self._makers = dict(makers)
        self._made = dict(made)

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            self._made[name] = self._makers[name]()
        return self._made[name]

    def __setitem__(self, name: str, command: Any) -> None:
        self._made[name] = command

    def __delitem__(self, name: str) -> None:
        del self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers | self._made)

    def __len__(self) -> int:
        return len(self._makers | self._made)


def commands_on_demand(makers: Mapping[str, Callable[[], Any]]) -> Any:
    """Return a group class whose commands are made on demand.

    Making all of them takes 0.8 s of processor time; the rest of the start-up takes 0.5 s.

    Parameters
    ----------
    makers : mapping of str to callable
        Returns the function of each command, or a Typer with the commands of a group.
    """

    def maker(name: str) -> Callable[[], Any]:
        return lambda: _command(name, makers[name])

    return type(
        "CommandList", (CommandList,), {"on_demand": {name: maker(name) for name in makers}}
    )


def _command(name: str, make: Callable[[], Any]) -> Any:
    """Return a single command or group, as Typer makes it for a group."""
    made = make()
    if isinstance(made, typer.Typer):
        return typer.main.get_group(made)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    panel = made.spec.workflow() if hasattr(made, "spec") else None
    alone.command(name, epilog=EPILOG, rich_help_panel=panel)(made)
    return typer.main.get_command(alone)
