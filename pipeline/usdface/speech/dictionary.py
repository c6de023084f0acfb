"""How words are said, by a user's own list: the form of the CMU dictionary."""

import re
from pathlib import Path

from usdface.core.errors import InputError
from usdface.speech.visemes import SILENCE, arpabet_of

LARGEST_DICTIONARY_BYTES = 64 << 20


def read_dictionary(path: Path) -> dict[str, tuple[str, ...]]:
    """Read pronunciations, one a line: ``kvothe  K V OW TH``.

    Stress digits are taken off, lines that begin with ``;;;`` or ``#`` are remarks, and of several
    entries for a word the first holds.

    Returns
    -------
    dict of str to tuple of str
        ARPAbet in upper case, by word in lower case.

    Raises
    ------
    InputError
        If the file cannot be read, or a line has no phones or one that is not ARPAbet.
    """
    said: dict[str, tuple[str, ...]] = {}
    for number, line in enumerate(read_text(path, LARGEST_DICTIONARY_BYTES).splitlines(), start=1):
        if not line.strip() or line.startswith((";;;", "#")):
            continue
        word, *symbols = line.split()
        known = [arpabet_of(symbol) for symbol in symbols]
        wrong = [
            symbol
            for symbol, phone in zip(symbols, known, strict=True)
            if phone is None or phone == SILENCE
        ]
        if not symbols or wrong:
            raise InputError(
                f"{path} line {number}: {word!r} has "
                + (f"the phone {wrong[0]!r}, which is no ARPAbet" if wrong else "no phones")
                + "; write the word, then its phones, as in: kvothe  K V OW TH"
            )
        name = re.sub(r"\(\d+\)$", "", word.lower())
        said.setdefault(name, tuple(phone.upper() for phone in known if phone is not None))
    return said


def read_text(path: Path, largest_bytes: int) -> str:
    """Read a text file of people, in UTF-8 or UTF-16.

    Raises
    ------
    InputError
        If it cannot be read or is too large.
    """
    try:
        if path.stat().st_size > largest_bytes:
            raise InputError(f"{path}: {path.stat().st_size} bytes are too many for a text")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 at byte {error.start}; save it as UTF-8") from error
