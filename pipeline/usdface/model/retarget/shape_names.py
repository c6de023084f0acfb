"""Meaning of shape names: motions of the face, on one or both sides, of one or both lips or lids.

``EyeBlinkLeft``, ``hero_bs_eyeBlink.L``, ``l_eye_closure`` and ``AU45_blink_left`` mean the same. A
list of names is read as a whole, to ignore the affixes that all names share. The vocabulary is in
`usdface.model.retarget.shape_vocabulary`.
"""

import functools
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

from usdface.model.retarget.shape_vocabulary import (
    ACTION_UNITS,
    CENTRES,
    FACEGOOD_MARKS,
    FACEGOOD_SECOND,
    FILLERS,
    METAHUMAN_MARKS,
    ROWED,
    ROWS,
    SIDE_WORDS,
    VOCABULARIES,
    WEAKER_UNITS,
    WORDS,
)

Cell = tuple[str, str, str]
"""A motion, its side (L or R) and its row, the upper or lower lip or lid (U or D)."""

Phrase = frozenset[str] | tuple[str, ...]

UNKNOWN_RANK = 9.0
"""Rank of a name in no vocabulary, whose motion is its words."""

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_A-Za-z]+")
_GAZES = {"raise": "up", "down": "down", "in": "in", "inner": "in", "out": "out", "outer": "out"}
_SHORTEST_GLUED = 5
"""Minimum number of letters of a word that is split into several, as in ``eyelookup``."""

_SHORTEST_ABBREVIATION = 3
"""Minimum number of consonants that stand for a word, as in ``lidCls``."""

_SHARED_BY = 3
"""Minimum number of names that share a prefix."""

_MOST_AFFIX_WORDS = 10
_MOST_READ_NAMES = 80
"""Maximum number of names from which prefix and suffix are found."""


@dataclass(frozen=True)
class Meaning:
    """Meaning of a name."""

    cells: frozenset[Cell]
    rank: float
    """Of two names with the same meaning, the one of lower rank is used."""
    motion: str
    """The motion without its side; ``browinnerup+browouterup`` for a shape of two."""
    side: str
    """L, R, or empty for both."""

    @property
    def understood(self) -> bool:
        """Whether the name is in a vocabulary."""
        return self.rank < UNKNOWN_RANK


def read_meanings(names: Sequence[str]) -> dict[str, Meaning]:
    """Return the meanings of the names of a rig, a take or a table."""
    return dict(_meanings(tuple(names)))


@functools.lru_cache(maxsize=8)  # selecting asks a dozen times for those of a rig's shapes
def _meanings(names: tuple[str, ...]) -> dict[str, Meaning]:
    words = {name: _words(name) for name in names}
    corners = _corner_codes(words.values())
    head, tail = _constant_affixes(list(words.values()), corners)
    stripped = {
        name: each[head : len(each) - tail] if len(each) > head + tail else each
        for name, each in words.items()
    }
    starts = Counter(_unknown_start(each) for each in stripped.values())
    found = {}
    for name, each in stripped.items():
        meaning = _read(each, corners)
        start = _unknown_start(each)
        if not meaning.understood and start and starts[start] >= _SHARED_BY:
            later = _read(each[len(start) :], corners)
            meaning = replace(later, rank=later.rank + 0.25) if later.understood else meaning
        found[name] = meaning
    if _marks_among(names, FACEGOOD_MARKS) == len(FACEGOOD_MARKS):
        for name, meaning in found.items():
            if meaning.motion in FACEGOOD_SECOND and "2" in words[name]:
                found[name] = replace(meaning, rank=meaning.rank - 0.25)
    return found


def motion_and_side(name: str) -> tuple[str, str]:
    """Return motion, in ARKit's words without capitals, and side (L, R or empty) of a shape."""
    meaning = read_meanings([name])[name]
    return meaning.motion, meaning.side


def has_metahuman_controls(names: Sequence[str]) -> bool:
    """Whether these are MetaHuman's raw controls, with any prefix."""
    return _marks_among(names, METAHUMAN_MARKS) >= 2


def _marks_among(names: Sequence[str], marks: frozenset[frozenset[str]]) -> int:
    """Return how many phrases of a vocabulary occur in a list of names."""
    every = [frozenset(WORDS.get(each, each) for each in _words(name)) for name in names]
    return sum(any(mark <= words for words in every) for mark in marks)


def mirrored(cells: frozenset[Cell]) -> frozenset[Cell]:
    """Return the same motion on the other side of the face."""
    return frozenset((_other_way(motion), "LR"[side == "L"], row) for motion, side, row in cells)


def _other_way(motion: str) -> str:
    for one, other in (("left", "right"), ("right", "left")):
        if motion.endswith(one):
            return motion.removesuffix(one) + other
    return motion


def _words(name: str) -> list[str]:
    base = unicodedata.normalize("NFKD", re.split(r"[:|/]", name)[-1] or name)
    base = re.sub(r"[\u0300-\u036f]", "", base)  # accents, which would part words
    base = unicodedata.normalize("NFKC", base)
    parts = [part for word in _WORD.findall(base) or [base] for part in _split_glued(word.lower())]
    return [part if part in FILLERS else _abbreviations().get(part, part) for part in parts]


@functools.cache
def _phrases() -> dict[Phrase, tuple[str, float]]:
    """Return motion and rank by phrase: a set of words, or a tuple of words in order."""
    motions: dict[Phrase, tuple[str, float]] = {}
    for rank, lines in VOCABULARIES:
        for line in lines.strip().splitlines():
            motion, _, phrases = line.strip().partition(": ")
            for phrase in phrases.split(" | "):
                words = phrase.split()
                optional = [each.strip("[]") for each in words if each.startswith("[")]
                needed = [each for each in words if not each.startswith("[")]
                for extra in ([], optional) if optional else ([],):
                    given = [each.removeprefix("=") for each in (*needed, *extra)]
                    as_set = frozenset(WORDS.get(each, each) for each in given)
                    in_order = phrase.startswith("=") or len(as_set) < len(given)
                    key: Phrase = tuple(given) if in_order else as_set
                    motions.setdefault(key, (motion, float(rank)))
    return motions


@functools.cache
def _lexicon() -> frozenset[str]:
    """Return all words of names."""
    words = {word for key in _phrases() for word in key} | set(WORDS.values())
    return frozenset(words | WORDS.keys() | ROWS.keys() | SIDE_WORDS.keys()) - {"a"}


@functools.cache
def _abbreviations() -> dict[str, str]:
    """Return known words by their consonants, ``close`` by ``cls``; not if several have these."""
    words: dict[str, set[str]] = {}
    for word in _lexicon():
        short = re.sub(r"(.)\1+", r"\1", word[0] + re.sub("[aeiou]", "", word[1:]))
        words.setdefault(short, set()).add(WORDS.get(word, word))
    return {
        short: min(of)
        for short, of in words.items()
        if len(of) == 1 and len(short) >= _SHORTEST_ABBREVIATION and short not in _lexicon()
    }


@functools.lru_cache(maxsize=4096)
def _split_glued(word: str) -> tuple[str, ...]:
    """Split a word into known words, or return it unchanged."""
    if len(word) < _SHORTEST_GLUED or word in _lexicon() or word in FILLERS or word.isdigit():
        return (word,)
    best: list[tuple[str, ...] | None] = [(), *([None] * len(word))]
    for end in range(1, len(word) + 1):
        for start in range(end):
            before, piece = best[start], word[start:end]
            if before is None or piece not in _lexicon():
                continue
            if piece == "upr" and end == len(word):
                continue  # `eyelookupr`: up, on the right
            if len(piece) < 2 and (end < len(word) - 1 or not before):
                continue  # single letters are sides and rows, at the end only
            current = best[end]
            if current is None or len(before) + 1 < len(current):
                best[end] = (*before, piece)
    return best[len(word)] or (word,)


def _corner_codes(lists: Iterable[Sequence[str]]) -> dict[str, tuple[str, str]]:
    """Return side and row by the codes of quarters of the lips: UL, DR; LB, RT.

    RT and LT are also sides: they are quarters if the list has LB or RB as well.
    """
    codes = {row + side: (side.upper(), row.upper()) for row, side in product("ud", "lr")}
    if any(word in ("lb", "rb") for words in lists for word in words):
        codes |= {side + row: (side.upper(), ROWS[row]) for side, row in product("lr", "tb")}
    return codes


def _constant_affixes(
    lists: list[list[str]], corners: dict[str, tuple[str, str]]
) -> tuple[int, int]:
    """Return the numbers of words in the common prefix and suffix to be ignored.

    Chosen are those with which most names are understood; of equal choices, the one that removes
    fewest words of the vocabulary.
    """
    if len(lists) < _SHARED_BY:
        return 0, 0
    shortest = min(map(len, lists))
    head = _common(lists, shortest)
    tail = _common([each[::-1] for each in lists], shortest - head)
    if not head + tail:
        return 0, 0
    sample = lists[:: max(len(lists) // _MOST_READ_NAMES, 1)]
    best, chosen = (-1, 0, 0), (0, 0)
    for first, last in product(range(head + 1), range(tail + 1)):
        if first + last >= shortest:
            continue
        understood = sum(
            _read(each[first : len(each) - last], corners).understood for each in sample
        )
        removed = [*lists[0][:first], *lists[0][len(lists[0]) - last :]]
        known = sum(each in _lexicon() for each in removed)
        score = (understood, -known, len(removed) - known)
        if score > best:
            best, chosen = score, (first, last)
    return chosen


def _common(lists: list[list[str]], most: int) -> int:
    count = 0
    while count < min(most, _MOST_AFFIX_WORDS) and len({each[count] for each in lists}) == 1:
        count += 1
    return count


def _unknown_start(words: Sequence[str]) -> tuple[str, ...]:
    """Return the unknown words at the start of a name, with ``#`` for numbers."""
    count = 0
    while count < len(words) and words[count] not in _lexicon():
        count += 1
    return tuple("#" if each.isdigit() else each for each in words[:count]) if count else ()


def _read(words: Sequence[str], corners: dict[str, tuple[str, str]]) -> Meaning:
    unit = _action_unit(words)
    letters = [each for each in words if each not in FILLERS and not each.isdigit()]
    numbered = 0.5 if any(each.isdigit() for each in words[1:]) and not unit else 0.0
    if unit:
        motion, rank = unit
        sides = {SIDE_WORDS[each] for each in letters if each in SIDE_WORDS}
        side = sides.pop() if len(sides) == 1 else ""
        if motion.startswith("look"):
            return _gaze(motion.removeprefix("look"), side, rank)
        return _meaning(motion, side, "", rank)
    found = _read_gaze(letters) or _read_phrase(letters, corners)
    if found is not None:
        return replace(found, rank=found.rank + numbered)
    at = [index for index, each in enumerate(words) if each in SIDE_WORDS]
    side = SIDE_WORDS[words[at[0]]] if len(at) == 1 < len(words) else ""
    rest = [WORDS.get(each, each) for each in words if not (side and each in SIDE_WORDS)]
    row = ""
    if not side and rest and rest[-1] in corners:
        side, row = corners[rest.pop()]
    return _meaning("".join(dict.fromkeys(rest)), side, row, UNKNOWN_RANK)


def _action_unit(words: Sequence[str]) -> tuple[str, float] | None:
    """Return motion and rank of AU12, AU_12, AU012 and the like."""
    for word, number in pairwise(words):
        if word == "au" and number.isdigit():
            unit = int(number)
            if unit in ACTION_UNITS:
                return ACTION_UNITS[unit], 1.0
            if unit in WEAKER_UNITS:
                return WEAKER_UNITS[unit], 2.0
    return None


def _read_gaze(words: list[str]) -> Meaning | None:
    """Read a look: the word after `look` is the direction, the remaining one the eye."""
    plain = [WORDS.get(each, each) for each in words]
    if "look" not in plain:
        return None
    at = plain.index("look")
    order = [*range(at + 1, len(words)), *range(at)]
    place = next((i for i in order if plain[i] in _GAZES or words[i] in SIDE_WORDS), None)
    if place is None:
        return None
    rest = [
        i for i in range(len(words)) if i not in (at, place) and plain[i] not in ("eye", "ball")
    ]
    sides = {SIDE_WORDS.get(words[i], "") for i in rest}
    if "" in sides or len(sides) > 1:
        return None
    way = _GAZES.get(plain[place]) or {"L": "left", "R": "right"}[SIDE_WORDS[words[place]]]
    return _gaze(way, sides.pop() if sides else "", 0.0)


def _gaze(way: str, side: str, rank: float) -> Meaning:
    cells: frozenset[Cell] = frozenset()
    for each in side or "LR":
        turn = way
        if way in ("left", "right"):  # ARKit's directions are relative to the nose
            turn = "out" if way[0].upper() == each else "in"
        cells |= _meaning(f"eyelook{turn}", each, "", rank).cells
    name = "+".join(sorted({cell[0] for cell in cells}))
    return Meaning(cells, rank, name, side)


def _read_phrase(words: list[str], corners: dict[str, tuple[str, str]]) -> Meaning | None:
    side, row = "", ""
    for index in range(len(words) - 1, 0, -1):
        if words[index] in corners:
            side, row = corners[words[index]]
            words = [*words[:index], *words[index + 1 :]]
            break
    found = _sided(words, side, row)
    if found is None and any(each in CENTRES for each in words) and len(words) > 1:
        found = _sided([each for each in words if each not in CENTRES], side, row)
    return found


def _sided(words: list[str], side: str, row: str) -> Meaning | None:
    """Look a phrase up as it is, then without one of its side words, the last one first."""
    places = [index for index in range(len(words) - 1, -1, -1) if words[index] in SIDE_WORDS]
    choices = [(words, side)]
    if not side:
        choices += [([*words[:i], *words[i + 1 :]], SIDE_WORDS[words[i]]) for i in places]
    for rest, which in choices:
        phrase = _look_up(rest)
        if phrase is not None:
            return _meaning(phrase[0], which, row, phrase[1])
    for rest, which in choices if not row else ():
        for index, word in enumerate(rest):
            single = len(word) == 1 and index < len(rest) - 1
            phrase = _look_up([*rest[:index], *rest[index + 1 :]]) if word in ROWS else None
            if phrase is not None and not single and phrase[0].partition("/")[0] in ROWED:
                return _meaning(phrase[0].partition("/")[0], which, ROWS[word], phrase[1])
    return None


def _look_up(words: list[str]) -> tuple[str, float] | None:
    if not words:
        return None
    found = _phrases().get(tuple(words))
    return found or _phrases().get(frozenset(_plain(each) for each in words))


def _plain(word: str) -> str:
    """Return a word as written in phrases; a side word in a phrase is a direction."""
    return WORDS.get(word) or {"L": "left", "R": "right", "": word}[SIDE_WORDS.get(word, "")]


def _meaning(motion: str, side: str, row: str, rank: float) -> Meaning:
    cells: set[Cell] = set()
    for part in motion.split("+"):
        stem, _, motion_row = part.partition("/")
        rows = row or (ROWS[motion_row] if motion_row else "UD")
        cells |= set(product([stem], side or "LR", rows))
    stem, _, motion_row = motion.partition("/")
    if stem in ("mouthroll", "mouthshrug"):
        stem += {"U": "upper", "D": "lower"}.get(row, motion_row)
    return Meaning(frozenset(cells), rank, stem, side)
