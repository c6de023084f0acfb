"""A journal loses nothing that it acknowledged, wherever it is cut."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdface.core.errors import InputError
from usdface.tuning.journal import Change, Journal

CHANGES = [
    Change(0, "kitchen", 101, {"jawOpen": 0.25}),
    Change(3, "küche ü", 7, {"jawOpen": 1.0, "smile": -0.125}, done=True),
    Change(3, "küche ü", 7, done=False),
]


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return Journal(tmp_path / "hero.tuned.journal")


def test_what_was_appended_is_replayed_in_order(journal: Journal) -> None:
    journal.append(CHANGES[:1])
    journal.append(CHANGES[1:])
    assert Journal(journal.path).replay() == CHANGES


def test_a_journal_that_is_not_there_replays_nothing(journal: Journal) -> None:
    assert journal.replay() == []
    journal.clear()


@given(lost=st.integers(min_value=0, max_value=400))
def test_a_journal_cut_at_any_byte_keeps_every_whole_line(tmp_path_factory, lost: int) -> None:
    journal = Journal(tmp_path_factory.mktemp("cut") / "journal")
    journal.append(CHANGES)
    raw = journal.path.read_bytes()
    kept = raw[: max(len(raw) - lost, 0)]
    journal.path.write_bytes(kept)
    whole = kept.count(b"\n")
    assert Journal(journal.path).replay() == CHANGES[:whole]
    # What is appended after a torn line stands on a line of its own.
    again = Journal(journal.path)
    again.replay()
    again.append(CHANGES[:1])
    assert Journal(journal.path).replay() == [*CHANGES[:whole], CHANGES[0]]


def test_a_last_line_of_zeros_as_a_crashed_machine_leaves_is_cut_off(journal: Journal) -> None:
    journal.append(CHANGES[:2])
    with journal.path.open("ab") as stream:
        stream.write(b"\0" * 40 + b"\n")
    assert journal.replay() == CHANGES[:2]


def test_a_damaged_line_in_the_middle_is_named_and_nothing_is_cut(journal: Journal) -> None:
    journal.append(CHANGES)
    lines = journal.path.read_bytes().splitlines(keepends=True)
    damaged = b"".join([lines[0], b"{}\n", lines[2]])
    journal.path.write_bytes(damaged)
    with pytest.raises(InputError, match=r"line 2 is not a change of weights; nothing was changed"):
        journal.replay()
    assert journal.path.read_bytes() == damaged


def test_a_journal_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "journal").mkdir()
    with pytest.raises(InputError, match="the change cannot be saved"):
        Journal(tmp_path / "journal").append(CHANGES)


def test_what_a_full_disk_took_of_a_change_is_removed(journal: Journal) -> None:
    journal.append(CHANGES[:1])
    room = journal.path.stat().st_size + 20
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(InputError, match="the change cannot be saved"):
            journal.append(CHANGES[1:2])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    journal.append(CHANGES[2:])
    assert journal.replay() == [CHANGES[0], CHANGES[2]]
