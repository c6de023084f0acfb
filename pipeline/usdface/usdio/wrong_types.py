"""What another tool wrote in place of numbers, or of a list, is refused by the file's name."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from pxr import Tf

from usdface.core.errors import InputError
from usdface.usdio.layers import usd_reason

P = ParamSpec("P")
R = TypeVar("R")


def refusing_wrong_types(read: Callable[P, R]) -> Callable[P, R]:
    """Turn what Python or USD says of a value of another type into an InputError for the file.

    USD keeps an attribute's type as it was authored, whatever its schema says, so any value may
    come out. The reader's first argument is a path, or has one.
    """

    @functools.wraps(read)
    def reading(*given: P.args, **named: P.kwargs) -> R:
        try:
            return read(*given, **named)
        except (TypeError, ValueError, IndexError, OverflowError, Tf.ErrorException) as error:
            file = getattr(given[0], "path", given[0])
            reason = usd_reason(error) if isinstance(error, Tf.ErrorException) else str(error)
            raise InputError(
                f"{file}: a value is not of the type or the length that its place asks for "
                f"({reason}); write the file again"
            ) from error

    return reading
