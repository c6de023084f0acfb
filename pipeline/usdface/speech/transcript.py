"""A transcript as people write it, as the words that are spoken."""

import re
import unicodedata

from usdface.core.errors import InputError

_ONES = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen "
    "fifteen sixteen seventeen eighteen nineteen"
).split()
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety".split()
_SCALES = ((10**9, "billion"), (10**6, "million"), (1000, "thousand"), (100, "hundred"))

_CLOSED_BY = {"[": "]", "<": ">", "{": "}", "(": ")"}
_OPENING = re.compile(r"[\[<{(]")
_DIGITS = re.compile(r"\d+(?:[.,]\d+)*")
LONGEST_NUMBER = 40
"""Characters; what is longer is read out digit by digit."""
_SIGNS = {"&": " and ", "%": " percent ", "@": " at ", "+": " plus "}


def spoken_words(text: str) -> tuple[str, ...]:
    """Return the words of a transcript, in lower case, numbers spelled out.

    What stands in brackets is a remark, as ``[laughs]`` or ``<noise>``, and is left out.


    Raises
    ------
    InputError
        If no word is left.
    """
    plain = _without_remarks(text.replace("’", "'"))
    plain = _DIGITS.sub(lambda found: f" {_number(found.group())} ", plain)
    for sign, word in _SIGNS.items():
        plain = plain.replace(sign, word)
    folded = unicodedata.normalize("NFKD", plain.lower())
    folded = "".join(letter for letter in folded if not unicodedata.combining(letter))
    words = (word.strip("'") for word in re.findall(r"[a-z']+", folded))
    spoken = tuple(word for word in words if word)
    if not spoken:
        raise InputError(
            f"the transcript {text.strip()[:40]!r} has no word in it; write what is said, in "
            "Latin letters"
        )
    return spoken


def _without_remarks(text: str) -> str:
    """Leave out what stands in brackets, each read once: a row of open ones costs no more."""
    kept, at = [], 0
    open_for_good: set[str] = set()
    for found in _OPENING.finditer(text):
        bracket, start = found.group(), found.start()
        if start < at or bracket in open_for_good:
            continue
        end = text.find(_CLOSED_BY[bracket], start)
        if end < 0:
            open_for_good.add(bracket)
            continue
        kept.append(text[at:start])
        at = end + 1
    return " ".join((*kept, text[at:]))


def _number(digits: str) -> str:
    if "." in digits and len(digits) <= LONGEST_NUMBER:
        whole, _, rest = digits.replace(",", "").partition(".")
        return " ".join([_whole(int(whole)), "point", *(_ONES[int(d)] for d in rest if d != ".")])
    plain = digits.replace(",", "").replace(".", "")
    if len(plain) > 12 or (len(plain) > 1 and plain[0] == "0"):  # a code, not a count
        return " ".join(_ONES[int(d)] for d in plain)
    return _whole(int(plain))


def _whole(value: int) -> str:
    if value < 20:
        return _ONES[value]
    if value < 100:
        rest = value % 10
        return _TENS[value // 10 - 2] + (f" {_ONES[rest]}" if rest else "")
    for size, name in _SCALES:
        if value >= size:
            rest = value % size
            return f"{_whole(value // size)} {name}" + (f" {_whole(rest)}" if rest else "")
    return _ONES[0]
