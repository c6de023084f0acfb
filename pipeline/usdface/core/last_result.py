"""A cache of one result, by the content of the arguments."""

from collections.abc import Callable
from functools import cached_property, wraps
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def _add_content(digest: Any, content: object) -> None:
    """Add arrays, scalars, containers and the attributes of other objects to a hash."""
    digest.update(type(content).__name__.encode())
    if isinstance(content, np.ndarray) and not content.dtype.hasobject:
        digest.update(f"{content.dtype.str}{content.shape}".encode())
        digest.update(np.ascontiguousarray(content).data)
    elif content is None or isinstance(content, (str, bytes, int, float, Path, np.generic)):
        digest.update(f"{content!r};".encode())
    elif isinstance(content, (tuple, list)):
        digest.update(f"{len(content)};".encode())
        for each in content:
            _add_content(digest, each)
    elif isinstance(content, frozenset):
        _add_content(digest, sorted(content))
    elif isinstance(content, dict):
        _add_content(digest, list(content))
        _add_content(digest, list(content.values()))
    else:
        for name, each in vars(content).items():
            # Cached properties follow from the others, and may be computed or not.
            if not isinstance(getattr(type(content), name, None), cached_property):
                digest.update(name.encode())
                _add_content(digest, each)


def cache_last_result(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function that computes again only if its arguments differ from the last ones.

    Steps of a job read the same rig and take, and need the same surface and placement. The result
    must not be changed by the caller.
    """
    last: tuple[bytes, Result] | None = None

    @wraps(function)
    def cached(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        nonlocal last
        digest, known = sha256(), last
        _add_content(digest, (args, kwargs))
        key = digest.digest()
        if known is None or known[0] != key:
            last = known = key, function(*args, **kwargs)
        return known[1]

    return cached
