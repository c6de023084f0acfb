"""A file appears whole or not at all, and one writer wins."""

import errno
import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from usdface.core import write_lock
from usdface.core.errors import InputError
from usdface.core.replacing import (
    check_not_written_since,
    not_written_since,
    replacing,
    replacing_group,
    replacing_together,
    write_new_text,
)

HOLD = """
import sys
import tempfile
from pathlib import Path
from usdface.core.replacing import replacing
with replacing(Path(sys.argv[1])) as temporary:
    temporary.write_text("first")
    print("holding", flush=True)
    sys.stdin.read()
"""


def holder(path: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "holding\n"
    return process


def as_nobody(path: Path) -> subprocess.CompletedProcess[str]:
    """Write a file as another user than this one, which is root."""
    program = HOLD.replace("with ", "import os\nos.seteuid(65534)\nwith ")
    return subprocess.run(
        [sys.executable, "-c", program, str(path)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def test_of_two_writers_one_wins_whole_and_the_other_says_so(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with holder(target) as first:
        with (
            pytest.raises(InputError, match=rf"another process is writing .*process {first.pid}"),
            replacing(target) as temporary,
        ):
            temporary.write_text("second")
        first.communicate()
    assert target.read_text() == "first"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_a_killed_writer_holds_no_lock_and_its_leftovers_are_cleared(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with holder(target) as first:
        os.kill(first.pid, signal.SIGKILL)
    assert not target.exists()
    assert len(list(tmp_path.iterdir())) == 2  # the temporary and the lock
    (tmp_path / ".ab.12345678.txt").write_text("another file's")
    with replacing(target) as temporary:
        temporary.write_text("second")
    assert target.read_text() == "second"
    assert sorted(each.name for each in tmp_path.iterdir()) == [".ab.12345678.txt", "a.txt"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs two users")
def test_a_killed_writers_lock_holds_no_other_user_off_and_a_living_ones_does() -> None:
    with tempfile.TemporaryDirectory() as name:  # tmp_path is nobody else's to enter
        folder = Path(name)
        folder.chmod(0o777)
        target = folder / "a.txt"
        with holder(target) as first:
            living = as_nobody(target)
            os.kill(first.pid, signal.SIGKILL)
        assert f"another process is writing it (process {first.pid}" in living.stderr
        assert not target.exists()
        assert as_nobody(target).stderr == ""
        assert target.read_text() == "first"
        assert [each.name for each in folder.iterdir()] == ["a.txt"]


def test_what_usd_left_beside_a_temporary_file_is_cleared_and_nothing_of_a_like_name(
    tmp_path: Path,
) -> None:
    target, other = tmp_path / "a.usdc", tmp_path / "a.usda"
    with replacing(target) as temporary:
        left = temporary.with_name(f"{temporary.stem}.lOgtAO")  # as USD names what it saves to
    with replacing(other) as busy:
        left.write_text("half")
        with replacing(target) as temporary:
            temporary.write_text("whole")
        assert not left.exists()
        assert busy.exists()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.usda", "a.usdc"]


def test_long_names_that_begin_alike_have_a_lock_each(tmp_path: Path) -> None:
    stem = "s" * 170
    together = [tmp_path / f"{stem}.weights.usdc", tmp_path / f"{stem}.usda"]
    with replacing_together(together) as temporaries:
        for each in temporaries:
            each.write_text("whole")
        with (
            pytest.raises(InputError, match="another process is writing it"),
            replacing(together[1]),
        ):
            pass
    assert sorted(tmp_path.iterdir()) == sorted(together)


@pytest.fixture(params=[errno.ENOLCK, errno.ENOSYS, errno.EINVAL], ids=errno.errorcode.get)
def no_locks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system without file locks, as network mounts say it."""

    def refused(*_: object) -> None:
        raise OSError(request.param, "no file locks")

    monkeypatch.setattr(write_lock.fcntl, "flock", refused)
    write_lock._warn_of_no_locks.cache_clear()


def test_without_file_locks_one_writer_holds_off_the_other_and_it_is_said(
    tmp_path: Path, no_locks: None, caplog: pytest.LogCaptureFixture
) -> None:
    target = tmp_path / "a.txt"
    with replacing(target) as first:
        first.write_text("first")
        with pytest.raises(InputError, match="another process is writing it"), replacing(target):
            pass
    assert target.read_text() == "first"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]
    assert [record.message.split(": ")[1][:35] for record in caplog.records] == [
        "this file system has no file locks;"
    ]


def test_without_file_locks_a_killed_writer_holds_off_nobody_and_one_elsewhere_does(
    tmp_path: Path, no_locks: None
) -> None:
    target, lock = tmp_path / "a.txt", tmp_path / ".a.txt.lock"
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    here = f"process {gone.pid} on {socket.gethostname()} {'a' * 32}, alone"
    lock.write_text(here)
    with replacing(target) as temporary:
        temporary.write_text("new")
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]
    for text in (here.replace(socket.gethostname(), "elsewhere"), ""):
        lock.write_text(text)
        with pytest.raises(InputError, match=r"remove \.a\.txt\.lock"), replacing(target):
            pass
        assert lock.read_text() == text


def test_a_lock_by_its_file_alone_is_honoured_by_who_has_file_locks(tmp_path: Path) -> None:
    (tmp_path / ".a.txt.lock").write_text(f"process 1 on elsewhere {'a' * 32}, alone")
    with (
        pytest.raises(InputError, match=r"process 1 on elsewhere\)"),
        replacing(tmp_path / "a.txt"),
    ):
        pass


def test_a_file_in_the_place_of_a_lock_is_never_written_to(tmp_path: Path) -> None:
    mine = tmp_path / "precious.txt"
    for text in ("my novel", ""):
        mine.write_text(text)
        (tmp_path / ".a.txt.lock").symlink_to(mine)
        with pytest.raises(InputError, match="is a link where usdface keeps a file"):
            with replacing(tmp_path / "a.txt"):
                pass
        (tmp_path / ".a.txt.lock").unlink()
        assert mine.read_text() == text
    mine.write_text("my novel")
    mine.rename(tmp_path / ".a.txt.lock")
    with (
        pytest.raises(InputError, match="is no lock of usdface"),
        replacing(tmp_path / "a.txt"),
    ):
        pass
    assert (tmp_path / ".a.txt.lock").read_text() == "my novel"


def test_a_lock_that_is_taken_away_stops_the_writing(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write() -> None:
        with replacing(target) as temporary:
            temporary.write_text("new")
            (tmp_path / ".a.txt.lock").unlink()

    with pytest.raises(InputError, match=r"its lock .* was removed"):
        write()
    assert target.read_text() == "old"


def test_what_is_made_anew_never_takes_the_place_of_anything(tmp_path: Path) -> None:
    target = tmp_path / "a.yaml"
    write_new_text(target, "first")
    (tmp_path / "b.yaml").symlink_to(tmp_path / "nothing")
    for path in (target, tmp_path / "b.yaml"):
        with pytest.raises(InputError, match="exists, and is not written over"):
            write_new_text(path, "late")
    with pytest.raises(InputError, match=r"the folder .* cannot be written to \(No such file"):
        write_new_text(tmp_path / "none" / "c.yaml", "lost")
    assert target.read_text() == "first"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.yaml", "b.yaml"]


def test_leftovers_that_cannot_be_cleared_stop_nobody(tmp_path: Path, monkeypatch) -> None:
    def refused(_: Path) -> None:
        raise PermissionError(errno.EACCES, "permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "iterdir", refused)
        with replacing(tmp_path / "a.txt") as temporary:
            temporary.write_text("whole")
    assert (tmp_path / "a.txt").read_text() == "whole"


def test_a_write_protected_file_is_refused_and_permissions_of_others_stay(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("locked by its artist")
    target.chmod(0o444)
    with pytest.raises(InputError, match=r"a\.txt: is write-protected"), replacing(target):
        pass
    assert target.read_text() == "locked by its artist"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]
    target.chmod(0o664)
    mask = os.umask(0o077)
    try:
        with replacing(target) as temporary:
            temporary.write_text("new")
        with replacing(tmp_path / "b.txt") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(mask)
    assert (target.stat().st_mode & 0o777, target.read_text()) == (0o664, "new")
    assert (tmp_path / "b.txt").stat().st_mode & 0o777 == 0o600


def test_an_error_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail() -> None:
        with replacing(target) as temporary:
            temporary.write_text("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert target.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_that_goes_away_meanwhile_is_named(tmp_path: Path) -> None:
    target = tmp_path / "gone" / "a.txt"
    target.parent.mkdir()

    def remove() -> None:
        with replacing(target) as temporary:
            temporary.unlink()
            for each in target.parent.iterdir():
                each.unlink()
            target.parent.rmdir()

    with pytest.raises(InputError, match="see that the folder is still there"):
        remove()
    assert not target.parent.exists()


def test_files_that_belong_together_are_all_whole_before_one_is_renamed(tmp_path: Path) -> None:
    first, second = tmp_path / "a.txt", tmp_path / "b.txt"
    first.write_text("old")

    def fail() -> None:
        with replacing_together([first, second]) as temporaries:
            temporaries[0].write_text("new")
            temporaries[1].unlink()

    with pytest.raises(InputError, match=r"b\.txt: cannot be replaced"):
        fail()
    assert first.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_files_written_one_by_one_appear_together_and_others_at_once(tmp_path: Path) -> None:
    samples, top, other = (tmp_path / name for name in ("a.samples.usdc", "a.usda", "part.usdc"))
    for path in (samples, top):
        path.write_text("old")
    placed = []

    def write(path: Path) -> None:
        with replacing_together([path], then=lambda each: placed.append(each.name)) as (temporary,):
            temporary.write_text("new")

    def write_all(*, failing: bool) -> None:
        with replacing_group([top, samples]):
            for path in (samples, other, top):
                write(path)
            assert [path.read_text() for path in (samples, top, other)] == ["old", "old", "new"]
            assert placed == ["part.usdc"]
            assert not failing

    with pytest.raises(AssertionError):
        write_all(failing=True)
    assert samples.read_text() == top.read_text() == "old"
    assert sorted(each.name for each in tmp_path.iterdir()) == [
        "a.samples.usdc",
        "a.usda",
        "part.usdc",
    ]
    placed.clear()
    write_all(failing=False)
    assert samples.read_text() == top.read_text() == "new"
    assert placed == ["part.usdc", "a.samples.usdc", "a.usda"]
    assert len(list(tmp_path.iterdir())) == 3  # no lock is left


@pytest.mark.parametrize("letter", ["a", "é", "漢", "😀"])
def test_a_name_as_long_as_a_folder_holds_is_written_in_any_script(
    tmp_path: Path, letter: str
) -> None:
    path = tmp_path / f"{letter * (250 // len(letter.encode()))}.usdc"
    with replacing(path) as temporary:
        temporary.write_bytes(b"x")
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_who_comes_to_write_when_another_has_written_says_so(tmp_path: Path) -> None:
    path = tmp_path / "shot.usda"
    for there in (False, True):
        with not_written_since([path]):
            check_not_written_since(path)
            with replacing(path) as temporary:
                temporary.write_text(f"of another process, {there}")
            with pytest.raises(InputError, match="another process wrote it meanwhile"):
                check_not_written_since(path)
        check_not_written_since(path)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="lists open files as Linux does")
def test_files_are_open_while_they_are_replaced_so_that_no_rename_waits_for_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / name for name in ("a.samples.usdc", "a.usda", "new.usda")]
    for path in paths[:2]:
        path.write_text("old")
    old = {path.stat().st_ino for path in paths[:2]}
    held, rename = [], Path.replace

    def replace(temporary: Path, target: Path) -> Path:
        links = [each for each in Path("/proc/self/fd").iterdir() if each.exists()]
        held.append(old <= {each.stat().st_ino for each in links})
        return rename(temporary, target)

    monkeypatch.setattr(Path, "replace", replace)
    with replacing_together(paths) as temporaries:
        for temporary in temporaries:
            temporary.write_text("new")
    assert held == [True, True, True]
    assert [path.read_text() for path in paths] == ["new"] * 3
