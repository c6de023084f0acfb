"""Ways to spoil a file, for tests that only our own error may leave a reader."""

from collections.abc import Callable, Sequence

from hypothesis import strategies as st

Spoil = Callable[[bytes], bytes]

TOKENS = [
    token.encode()
    for token in (
        *("nan", "1e999", "-1", "1e308", "0", "9" * 5000, "", "null", "true", "{}", "[]", '""'),
        *("\\ud800", "\x00", "\n", "\r\n\r\n", ",", ":", '"', "- ", "&a *a", "!!python/name:os"),
        *("!!timestamp x", "!!int ''", "!!bool x", "2001-99-99", "9" * 400, "Infinity"),
        *("\ufeff", "é", "..", "/", "<<: *a", "% TAG"),
    )
]
"""What readers stumble over: numbers that are none, too long, or another language."""

DEEP = [b"[" * 20_000, b'{"a":' * 20_000, b"(" * 20_000]


def damage(deep: Sequence[bytes] = DEEP) -> st.SearchStrategy[Spoil]:
    """Cuts at random places, flipped bytes, stretches moved elsewhere, and odd values put in."""
    place = st.floats(0, 1, exclude_max=True)
    printable = st.sampled_from(list(b'0123456789.,-e;\t\n"|#NnaIi: \x00\xff'))
    changes = st.tuples(place, st.integers(0, 255) | printable)
    return (
        place.map(_cut)
        | st.lists(changes, min_size=1, max_size=8).map(_flip)
        | st.tuples(place, place, place).map(_move)
        | st.tuples(place, st.sampled_from([*TOKENS, *deep]), st.integers(0, 12)).map(_put)
    )


def _cut(at: float) -> Spoil:
    return lambda content: content[: int(at * len(content))]


def _flip(changes: list[tuple[float, int]]) -> Spoil:
    def apply(content: bytes) -> bytes:
        changed = bytearray(content)
        for at, value in changes:
            changed[int(at * len(changed))] = value
        return bytes(changed)

    return apply


def _move(ends: tuple[float, float, float]) -> Spoil:
    def apply(content: bytes) -> bytes:
        first, second, at = (int(end * len(content)) for end in ends)
        low, high = sorted((first, second))
        return content[:at] + content[low:high] + content[at:]

    return apply


def _put(where: tuple[float, bytes, int]) -> Spoil:
    """Put a token in the place of some bytes that begin after the next blank, colon or comma."""
    at, token, length = where

    def apply(content: bytes) -> bytes:
        begin = int(at * len(content))
        marks = [found for mark in b" :,\t" if (found := content.find(mark, begin)) >= 0]
        start = min(marks, default=begin - 1) + 1
        return content[:start] + token + content[start + length :]

    return apply
