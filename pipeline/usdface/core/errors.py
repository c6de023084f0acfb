"""Errors a user can act on.

A message has four parts: what failed, where (file, prim, frame), the value found, what to do next.
"""


class UsdfaceError(Exception):
    """Base of every error this package raises on purpose.

    ``exit_code`` is what the command line returns: scripts and farms rely on it.
    """

    exit_code = 2


class InputError(UsdfaceError):
    """A file, a spec or a value from outside cannot be used."""


class CheckFailedError(UsdfaceError):
    """The input was read and the work was done, and what was checked is not in order."""

    exit_code = 1


class CancelledError(UsdfaceError):
    """The user or the farm asked the work to stop; nothing half done was left behind."""

    exit_code = 3
