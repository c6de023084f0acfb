"""Write beside, then rename: whoever reads sees the old file or the new one, never half."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from usdface.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder; it takes the place of `path` on success.

    Parameters
    ----------
    path : Path
        The file to make or to replace.

    Yields
    ------
    Path
        To write to; it ends as `path` does, so that encoders know the format.

    Raises
    ------
    InputError
        If the folder is missing, `path` is a folder, or either cannot be written. The old file,
        if there is one, is as it was.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; make it first")
    temporary = path.with_name(f".{path.stem[:80]}.{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        _touch(temporary, target=path)
        yield temporary
        try:
            with temporary.open("rb+") as written:
                os.fsync(written.fileno())
            temporary.replace(path)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be replaced ({error.strerror}); free the disk or the file"
            ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _touch(temporary: Path, *, target: Path) -> None:
    """Fail here, by name, rather than deep inside an encoder."""
    try:
        temporary.touch()
    except OSError as error:
        raise InputError(
            f"{target}: the folder {target.parent} cannot be written to ({error.strerror}); "
            "write elsewhere or ask for the right to"
        ) from error
