"""Worker processes: their number, start and end; threads for arithmetic on arrays."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from types import ModuleType
from typing import Any, TypeVar

_MOST_THREADS = 8
"""Each holds arrays of its own, and they wait for Python's lock between operations."""

Given = TypeVar("Given")
Made = TypeVar("Made")

SubmitWork = Callable[..., Future[Any]]
"""Takes a function and its arguments, as `Executor.submit`."""

_ENDING_SECONDS = 0.5
"""Time for a process to end by itself after an error."""


def process_count(wanted: int | None = None) -> int:
    """Return the number of worker processes, by default the number of usable cores.

    In a DCC it is one, as its executable would start another DCC.
    """
    names = (sys.executable or "", *(sys.orig_argv[:1] or [""]))
    if not all(Path(name).stem.lower().startswith("python") for name in names):
        return 1
    return wanted or usable_cores()


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS or Windows
        return os.cpu_count() or 1


@contextmanager
def background_threads(count: int = 1) -> Iterator[SubmitWork]:
    """Start threads with the work submitted, which is not waited for if the block raises.

    For functions that release Python's lock, as arithmetic on arrays does, and write no files.
    """
    pool = ThreadPoolExecutor(count)
    try:
        yield pool.submit
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def map_threads(function: Callable[[Given], Made], items: Iterable[Given]) -> list[Made]:
    """Return a function of each item, computed on the usable cores, at most `_MOST_THREADS`.

    Items must not depend on the number of cores, as results would in their rounding.
    """
    given = list(items)
    if len(given) < 2:
        return [function(item) for item in given]
    with background_threads(min(usable_cores(), _MOST_THREADS)) as submit:
        return [work.result() for work in [submit(function, item) for item in given]]


@contextmanager
def worker_processes(
    count: int, set_up: Callable[..., None], *given: object
) -> Iterator[SubmitWork]:
    """Start processes with the first work, and end them with the block.

    They are spawned, since a fork would copy locks of the ray tracer and of codecs. Ctrl+C reaches
    this process alone; if the block raises, the others end within a second. They end if this
    process is killed, too.

    `set_up`: called once in each, with the given arguments and a function that returns whether to
    stop.
    """
    context = get_context("spawn")
    stop, others = context.Event(), set(active_children())
    pool = ProcessPoolExecutor(
        count,
        mp_context=context,
        initializer=partial(_set_up_worker, set_up),
        initargs=(*given, stop.is_set),
    )

    def submit(work: Callable[..., Any], *arguments: object) -> Future[Any]:
        with _without_main(), _without_interrupts():
            return pool.submit(work, *arguments)

    try:
        yield submit
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


def _set_up_worker(set_up: Callable[..., None], *given: object) -> None:
    """Set up this process, which holds both ends of its pipes, so that they outlive the parent."""
    Thread(target=_end_with_parent, daemon=True).start()
    set_up(*given)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the main script, which new processes would run again without a `__main__` guard."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes started in the block ignore Ctrl+C, which a terminal sends to all."""
    try:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
