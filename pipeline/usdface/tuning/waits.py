"""Threads of the tuning page's server that are abandoned when it stops.

Placing markers, packing a large face and decoding a video take seconds and write nothing: Ctrl+C
does not wait for them.
"""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any, TypeVar

_Made = TypeVar("_Made")


class StoppedError(Exception):
    """The server has stopped before the result was ready."""


class Waits:
    """Requests that wait for threads; they are ended when the server stops.

    The threads continue until the process ends.
    """

    def __init__(self) -> None:
        self._stopped = False
        self._waiting: set[asyncio.Future[Any]] = set()

    async def result_of(self, make: Callable[[], _Made]) -> _Made:
        """Run a function in a new thread and return its result."""
        if self._stopped:
            raise StoppedError
        loop = asyncio.get_running_loop()
        made: asyncio.Future[_Made] = loop.create_future()

        def settle(result: Any, error: BaseException | None) -> None:
            if made.done():
                return
            if error is None:
                made.set_result(result)
            else:
                made.set_exception(error)

        def work() -> None:
            result: _Made | None = None
            fault: BaseException | None = None
            try:
                result = make()
            except BaseException as error:  # raised in the waiting request
                fault = error
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(settle, result, fault)

        self._waiting.add(made)
        threading.Thread(target=work, name="tune").start()
        try:
            return await made
        finally:
            self._waiting.discard(made)

    def stop(self) -> None:
        """End all waits, also future ones."""
        self._stopped = True
        for each in self._waiting:
            if not each.done():
                each.set_exception(StoppedError())
