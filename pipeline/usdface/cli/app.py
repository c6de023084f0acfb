"""All commands: those of steps are generated from their specs, the others are functions."""

import contextlib
import errno
import os
import sys
import traceback
from functools import cache
from typing import Annotated, Any, NoReturn, cast

import typer
from typer.main import get_command

from usdface.cli.command_list import EPILOG, CommandList
from usdface.cli.commands import (
    COMPLETE_VARIABLE,
    check,
    completion,
    demo,
    describe,
    list_edits,
    names,
    run,
    validate,
)
from usdface.cli.console import (
    INTERRUPTED_MESSAGE,
    echo,
    exit_at_once,
    exit_code_of,
    raise_on_signals,
    set_up_logging,
    show_error,
    show_json,
    unwritable_output,
    was_stopped,
)
from usdface.cli.step_commands import add_step_commands
from usdface.core.errors import CancelledError, CheckFailedError, UsdfaceError
from usdface.core.version import __version__

_FUNCTIONS = {
    "jobs": (run, check, demo, completion),
    "performance": (describe,),
    "retarget": (names,),
    "edits": (validate,),
}
"""Commands without a spec, by the workflow that they are listed under."""


@cache
def make_app(only: str | None = None, *, listed: bool = False) -> CommandList:
    """Return the command line.

    Faster to make than all of it is one command (`only`), or a list without options (`listed`).
    """
    made = typer.Typer(
        name="usdface",
        cls=CommandList,
        help="Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline.",
        epilog=EPILOG,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback()(_top)
    groups = add_step_commands(made, only, listed=listed)
    if "edits" in groups:
        groups["edits"].command("list", epilog=EPILOG)(list_edits)
    for workflow, functions in _FUNCTIONS.items():
        for function in functions:
            if only in (None, function.__name__):
                made.command(epilog=EPILOG, rich_help_panel=workflow)(function)
    return cast(CommandList, get_command(made))


def _version(wanted: bool) -> None:
    if wanted:
        echo(f"usdface {__version__}")
        raise typer.Exit


def _top(
    verbose: Annotated[
        bool,
        typer.Option("--verbose", help="Log progress, and print tracebacks of internal errors."),
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    set_up_logging(verbose=verbose)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    raise_on_signals()
    try:
        _run(sys.argv[1:] if arguments is None else arguments)
    except SystemExit as ended:
        if arguments is None and (was_stopped() or ended.code == CancelledError.exit_code):
            exit_at_once(int(ended.code or 0))
        raise


def _run(given: list[str]) -> NoReturn:
    if given[:1] == ["help"]:
        given = [*given[1:], "--help"]
    if COMPLETE_VARIABLE in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()  # Typer does so only for apps that install completion themselves
    as_json = "--json" in given
    try:
        code = _app_for(given)(args=given, standalone_mode=False)
    except (Exception, KeyboardInterrupt) as error:
        if was_stopped() and not isinstance(error, CancelledError | KeyboardInterrupt):
            error = CancelledError(INTERRUPTED_MESSAGE)
        _fail_by(error, verbose="--verbose" in given, as_json=as_json)
    sys.exit(code if isinstance(code, int) else 0)


def _app_for(given: list[str]) -> CommandList:
    """Return the part of the command line that these arguments use."""
    if given and (one := make_app(given[0])).commands:
        return one
    return make_app(listed=given in (["-h"], ["--help"]))


def _fail_by(error: BaseException, *, verbose: bool, as_json: bool) -> NoReturn:
    """Print an error and exit with its code."""
    if isinstance(error, UsdfaceError | KeyboardInterrupt):
        shown = isinstance(error, CheckFailedError)  # already in the failures of the JSON result
        _fail(str(error) or "interrupted", exit_code_of(error), as_json=as_json and not shown)
    if isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None:
        _fail(str(unwritable_output(error)), 2, as_json=False)  # --help, printed by typer
    if hasattr(error, "format_message"):
        _fail_usage(error, as_json=as_json)
    if verbose:
        traceback.print_exception(error)
    _fail(
        f"internal error: {type(error).__name__}: {error}\n"
        "No partly written files remain. Please report it with the output of "
        "`usdface --verbose` and the same arguments.",
        exit_code_of(error),
        as_json=as_json,
    )


def _fail_usage(error: Any, *, as_json: bool) -> NoReturn:
    """Print a usage error of click, or of Typer's copy of it, and exit."""
    from pydantic import ValidationError  # not at the top, so that --help starts faster

    if isinstance(error.__cause__, ValidationError):
        from usdface.specs.reading import fault_reason

        error.message = fault_reason(error.__cause__.errors()[0])
    if as_json:
        _fail(error.format_message(), error.exit_code, as_json=True)
    error.show()
    sys.exit(error.exit_code)


def _fail(message: str, code: int, *, as_json: bool) -> NoReturn:
    """Print an error, with --json also as JSON on stdout, and exit."""
    if as_json:
        with contextlib.suppress(UsdfaceError):  # the error may be an unwritable stdout
            show_json({"error": message, "exit_code": code})
    show_error(message)
    sys.exit(code)
