"""Options that many commands have."""

import inspect
from pathlib import Path
from typing import Annotated, Any

import typer

from usdface.cli.console import ProgressStyle

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
ShowProgress = Annotated[
    ProgressStyle,
    typer.Option(
        "--progress",
        help="Progress output. Default: a bar on a terminal, elsewhere a line every ten seconds.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite", help="Replace existing outputs, including newer files and files of others."
    ),
]
SaveSpec = Annotated[
    Path | None,
    typer.Option(
        "--save-spec", help="Write the spec of this command to a new file, without running it."
    ),
]


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


COMMON = [
    _keyword("overwrite", Overwrite, False),
    _keyword("save_spec", SaveSpec, None),
    _keyword("progress", ShowProgress, "auto"),
    _keyword("as_json", Json, False),
]
"""Options of every step's command."""
