"""Command groups: commands built on demand, listed in sections, interrupted by Ctrl+C."""

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import Any, ClassVar

import typer
from typer.core import TyperGroup

from usdface.cli.console import STOPPED
from usdface.cli.spec_options import current_options
from usdface.core.errors import CancelledError

EPILOG = "Exit codes: 0 done, 1 a check failed, 2 bad input, 3 interrupted."

SECTIONS = {
    "Capture": ("ingest", "align", "clean", "phones"),
    "References": ("select", "references", "tune"),
    "Performance": ("train", "map", "join", "describe"),
    "Edits and publish": ("edit", "edits", "bake", "package", "validate"),
    "Review": ("sheet", "movie", "movie-join", "report", "faces", "evaluate"),
    "Retargeting": (
        "pairs",
        "train-retarget",
        "retarget",
        "cyclic",
        "make-sequence",
        "find-sequences",
        "warp",
    ),
    "Meshes without shapes": ("bind", "deform", "make-shapes"),
    "Jobs": ("run", "check", "submit", "demo"),
}

LONGEST = 500
"""Largest length of a summary in characters; click would cut it to one line."""


# In what follows types are click's or, by Typer's version, those of its private copy of click.
class CommandList(TyperGroup):
    """A group whose help is read from top to bottom, in the order in which a shot is made."""

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
        """Run a command; Ctrl+C ends it as a farm's SIGTERM does.

        Typer would end it with 130 and without a word.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise CancelledError(STOPPED) from interrupt

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write name and summary of every command, under headings where the group has them."""
        summaries = {
            name: command.get_short_help_str(LONGEST)
            for name in self.list_commands(ctx)
            if (command := self.get_command(ctx, name)) is not None and not command.hidden
        }
        width = max(map(len, summaries), default=0)
        sections = SECTIONS if ctx.parent is None else {}
        for heading, names in sections.items():
            _write(formatter, heading, {name: summaries.pop(name) for name in names}, width)
        _write(formatter, "Commands", summaries, width)


class _MadeOnDemand(MutableMapping[str, Any]):
    """Commands by name, of which a process makes the one that it runs."""

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


def commands_on_demand(functions: Mapping[str, Callable[[], Callable[..., None]]]) -> Any:
    """Return a class of groups whose commands are made when they are asked for.

    Making all of them takes a third of the time in which a command starts.

    Parameters
    ----------
    functions : mapping of str to callable
        Makes the function behind each command; its signature becomes the command's.
    """

    def maker(name: str) -> Callable[[], Any]:
        return lambda: _command(name, functions[name]())

    return type("CommandList", (CommandList,), {"on_demand": {n: maker(n) for n in functions}})


def _command(name: str, function: Callable[..., None]) -> Any:
    """Return a command by itself, as it would be in a group of Typer's."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    alone.command(name, epilog=EPILOG)(function)
    return typer.main.get_command(alone)


def _write(formatter: Any, heading: str, summaries: dict[str, str], width: int) -> None:
    if summaries:
        with formatter.section(heading):
            formatter.write_dl([(name.ljust(width), text) for name, text in summaries.items()])
