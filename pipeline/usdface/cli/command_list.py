"""How a group lists its commands, by what they are for, and what Ctrl+C does to one."""

from typing import Any

from typer.core import TyperGroup

from usdface.cli.console import STOPPED
from usdface.errors import CancelledError

SECTIONS = {
    "Capture": ("ingest", "align", "clean", "phones"),
    "References": ("select", "references", "tune"),
    "Performance": ("train", "map", "join", "describe"),
    "Edits and publish": ("edit", "edits", "bake", "package", "validate"),
    "Review": ("sheet", "movie", "movie-join", "report", "faces", "evaluate"),
    "Face to face": (
        "pairs",
        "train-retarget",
        "retarget",
        "cyclic",
        "make-sequence",
        "find-sequences",
        "warp",
    ),
    "A mesh without shapes": ("bind", "deform", "make-shapes"),
    "Jobs": ("run", "check", "submit", "demo"),
}

LONGEST = 500
"""Characters of a summary: as many as its sentence has. Click would cut it to fit one line."""


class CommandList(TyperGroup):
    """A group whose help is read from top to bottom, in the order in which a shot is made."""

    # All types are click's or, by Typer's version, those of its private copy of click.
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


def _write(formatter: Any, heading: str, summaries: dict[str, str], width: int) -> None:
    if summaries:
        with formatter.section(heading):
            formatter.write_dl([(name.ljust(width), text) for name, text in summaries.items()])
