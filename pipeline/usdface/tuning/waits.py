"""Work of the tuning page's server that nobody waits for once it stops.

Placing the markers, packing a large face and decoding a video take seconds, and write nothing:
Ctrl+C does not wait for them.
"""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any, TypeVar

_Made = TypeVar("_Made")


class StoppedError(Exception):
    """The server stops, and does not wait for what was asked for."""


class Waits:
    """Requests that wait for threads which write nothing; they end when the server stops.

    The threads go on until the process ends.
    """

    def __init__(self) -> None:
        self._stopped = False
        self._waiting: set[asyncio.Future[Any]] = set()

    async def result_of(self, make: Callable[[], _Made]) -> _Made:
        """Run a function in a thread of its own and return its result."""
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
            except BaseException as error:  # whoever waits gets it
                fault = error
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits
                loop.call_soon_threadsafe(settle, result, fault)

        self._waiting.add(made)
        threading.Thread(target=work, name="tune").start()
        try:
            return await made
        finally:
            self._waiting.discard(made)

    def stop(self) -> None:
        """End all waits, and those that are still to come."""
        self._stopped = True
        for each in self._waiting:
            if not each.done():
                each.set_exception(StoppedError())
