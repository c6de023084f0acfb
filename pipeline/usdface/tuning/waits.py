"""Threads of the tuning page's server that are abandoned when it stops.

Placing markers, packing a large face and decoding a video take seconds and write nothing: Ctrl+C
does not wait for them.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

_Made = TypeVar("_Made")

_MOST_THREADS = 64
"""More than a browser's requests, as those that wait for the markers keep their thread."""


class StoppedError(Exception):
    """The server has stopped before the result was ready."""


class Waits:
    """Requests that wait for threads; they are ended when the server stops.

    The threads continue until the process ends.
    """

    def __init__(self) -> None:
        self._stopped = False
        self._threads = ThreadPoolExecutor(_MOST_THREADS, "tune")
        self._waiting: set[asyncio.Future[Any]] = set()

    async def result_of(self, make: Callable[[], _Made]) -> _Made:
        """Run a function in a thread and return its result."""
        if self._stopped:
            raise StoppedError
        made = asyncio.get_running_loop().run_in_executor(self._threads, make)
        self._waiting.add(made)
        try:
            return await made
        except asyncio.CancelledError:
            raise StoppedError from None
        finally:
            self._waiting.discard(made)

    def stop(self) -> None:
        """End all waits, also future ones."""
        self._stopped = True
        for each in self._waiting:
            each.cancel()
