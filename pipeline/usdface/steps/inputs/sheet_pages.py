"""Files of a sheet's pages: NAME.jpg, NAME.2.jpg and so on."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.replacing import replacing_group
from usdface.runner.origin import provenance_of, spec_of


@contextmanager
def replacing_pages(out: Path, count: int, *, step: str) -> Iterator[list[Path]]:
    """Yield the file of each page of a sheet, which the block writes; all are renamed together.

    Refuse pages that would replace other files. Further pages of an earlier sheet are removed.
    """
    files = [_page_file(out, number) for number in range(count)]
    for file in files[1:]:
        if file.exists() and not _is_page_of(file, out, step):
            raise InputError(
                f"{file}: exists, and would be replaced by a page of {out.name}; move it "
                "away, or choose another --out"
            )
    with replacing_group(files):
        yield files
    further = count
    while _is_page_of(old := _page_file(out, further), out, step):
        old.unlink()
        further += 1


def _page_file(out: Path, number: int) -> Path:
    return out.with_name(f"{out.stem}.{number + 1}{out.suffix}") if number else out


def _is_page_of(file: Path, out: Path, step: str) -> bool:
    """Whether a file is a further page of a step's sheet `out`."""
    made = provenance_of(file) if file.is_file() else None
    return made is not None and made.step == step and spec_of(made).get("out") == out.name
