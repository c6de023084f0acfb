"""Command groups: listed in sections, interrupted by Ctrl+C."""

from typing import Any

from typer.core import TyperGroup

from usdface.cli.console import INTERRUPTED_MESSAGE
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


# Types below are click's or, depending on Typer's version, those of its private copy of click.
class CommandList(TyperGroup):
    """A group whose help lists commands by section, in the order of the workflow."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl+C raises CancelledError, where Typer would exit without a message."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise CancelledError(INTERRUPTED_MESSAGE) from interrupt

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
