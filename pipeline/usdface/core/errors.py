"""Errors that a user can act on.

A message has four parts: the failure, its place (file, prim, frame), the value, and the remedy.
"""

import contextlib
from collections.abc import Iterator


class UsdfaceError(Exception):
    """Base of the errors of this package; `exit_code` is that of the command line."""

    exit_code = 2


class InputError(UsdfaceError):
    """A file, a spec or a value cannot be used."""


class CheckFailedError(UsdfaceError):
    """A check was completed, and found faults."""

    exit_code = 1


class CancelledError(UsdfaceError):
    """The user or the farm cancelled the work; no output was changed."""

    exit_code = 3


@contextlib.contextmanager
def as_input_error(where: object, of: type[Exception] = ValueError) -> Iterator[None]:
    """Raise an error of the block as an InputError that begins with `where` and a colon."""
    try:
        yield
    except of as error:
        raise InputError(f"{where}: {error}") from error
