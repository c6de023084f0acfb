"""A cache of one result, by the content of the arguments."""

import pickle
from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class _ContentHash:
    """A file that hashes what is written to it, so that pickled arrays are not copied."""

    def __init__(self) -> None:
        self._hash = sha256()
        self.write = self._hash.update

    def of(self, content: object) -> bytes:
        """Return the hash of a picklable object."""
        pickle.Pickler(self, protocol=5).dump(content)
        return self._hash.digest()


def cache_last_result(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function that computes again only if its arguments differ from the last ones.

    Steps of a job read the same rig and take, and need the same surface and placement. The result
    must not be changed by the caller.
    """
    last: tuple[bytes, Result] | None = None

    @wraps(function)
    def cached(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        nonlocal last
        key, known = _ContentHash().of((args, kwargs)), last
        if known is None or known[0] != key:
            last = known = key, function(*args, **kwargs)
        return known[1]

    return cached
