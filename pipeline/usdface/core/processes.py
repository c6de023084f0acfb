"""Work in several processes: how many there may be, and how they are started and stopped."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from pathlib import Path
from types import ModuleType
from typing import Any

GiveWork = Callable[..., Future[Any]]
"""Takes a function and its arguments, as `Executor.submit`."""

_ENDING_SECONDS = 0.5
"""In which a process may end its work, once nobody waits for it."""


def process_count(wanted: int | None = None) -> int:
    """Return how many processes are to work: by default as many as there are cores for them.

    In a DCC it is one, as another would be a DCC.
    """
    names = (sys.executable or "", *(sys.orig_argv[:1] or [""]))
    if not all(Path(name).stem.lower().startswith("python") for name in names):
        return 1
    return wanted or usable_cores()


def usable_cores() -> int:
    """Return how many cores this process may use, which on a farm are fewer than there are."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS or Windows
        return os.cpu_count() or 1


@contextmanager
def worker_processes(count: int, set_up: Callable[..., None], *given: object) -> Iterator[GiveWork]:
    """Start processes with the first work that they are given, and end them with the block.

    They are not forked, which would copy locks that ray tracer and codecs hold. Ctrl+C reaches this
    process alone; where the block raises, theirs is over within a second.

    Parameters
    ----------
    set_up : callable
        Called once in each, with what is given and a function that says whether nobody waits for
        its work any more.
    """
    context = get_context("spawn")
    stop, others = context.Event(), set(active_children())
    pool = ProcessPoolExecutor(
        count, mp_context=context, initializer=set_up, initargs=(*given, stop.is_set)
    )

    def give(work: Callable[..., Any], *arguments: object) -> Future[Any]:
        with _without_main(), _without_interrupts():
            return pool.submit(work, *arguments)

    try:
        yield give
    except BaseException:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        ends = time.monotonic() + _ENDING_SECONDS
        for process in set(active_children()) - others:
            process.join(max(ends - time.monotonic(), 0))
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the script that runs: new processes would run it again if it has no `__main__` guard."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that are started ignore Ctrl+C, which a terminal sends to all."""
    try:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # only the main thread may say so
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
