"""Pairs are not moved under the hand that tunes them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.locks import TuningLock
from usdface.core.sidecars import journal_path, lock_path

_REMEDY = (
    "to write pairs now would move them under their hand. Wait until that page is closed, or write "
    "to another --out"
)


@contextmanager
def nobody_tunes(references: Path) -> Iterator[None]:
    """Hold a references asset while its pairs are written, so that nobody begins to tune them.

    Parameters
    ----------
    references : Path
        The asset that is to be written.

    Raises
    ------
    InputError
        If somebody tunes it, or a page that crashed left changes that are not in the tuned layer.
        Nothing is changed.
    """
    lock = TuningLock(lock_path(references))
    lock.acquire(remedy=_REMEDY)
    try:
        check_nothing_unsaved(references)
        yield
    finally:
        lock.release()


def check_nobody_tunes(references: Path) -> None:
    """Refuse at the beginning what would be refused when it is to be written."""
    with nobody_tunes(references):
        pass


def check_nothing_unsaved(references: Path) -> None:
    """Refuse to write over changes that a page left behind when it was killed."""
    journal = journal_path(references)
    if journal.is_file() and journal.stat().st_size:
        raise InputError(
            f"{journal}: holds changes of a tuning page that was killed, which are not in the "
            f"tuned layer yet. Start `usdface tune {references.name}` once, which takes them in, "
            "close it with Ctrl+C, and do this again; or write to another --out"
        )
