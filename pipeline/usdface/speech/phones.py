"""Phones, words and emotions as spans of time, and the 15 visemes of phones.

Visemes are those of Deng et al. (2006), Table 1, each named after its first phone. Symbols of
several alphabets are accepted.
"""

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray

SILENCE = "pau"

VISEME_PHONES: dict[str, tuple[str, ...]] = {
    "pau": ("pau",),
    "b": ("b", "p", "m"),
    "k": ("k", "g", "ng"),
    "ae": ("ae", "ax", "ah", "aa"),
    "f": ("f", "v"),
    "ch": ("ch", "sh", "jh"),
    "ao": ("ao", "y", "iy", "ih", "ay", "aw"),
    "ow": ("ow", "oy"),
    "n": ("n", "d", "t", "l"),
    "ey": ("ey", "eh", "el", "em", "en", "er"),
    "th": ("th", "dh"),
    "s": ("s", "z", "zh"),
    "r": ("r",),
    "w": ("w", "uw", "uh"),
    "hh": ("hh",),
}
"""The paper's grouping, in the paper's order."""

VISEMES = tuple(VISEME_PHONES)

_VISEME_OF = {phone: name for name, phones in VISEME_PHONES.items() for phone in phones}

# Symbols of silence, breath and noise in various aligners.
_SILENT = frozenset(
    "pau sil sp spn nsn <s> </s> <sil> <eps> <unk> h# # _ epi brth breath noise [noise] [speech] "
    "++noise++ +noise+ ++breath++ ++cough++ ++smack++ ++uh++ ++um++ {sl} {ns} silence pause".split()
)

# Additions of TIMIT and HTK's recipes to ARPAbet. A closure looks like its stop; the glottal stop,
# like /hh/, is not visible.
_TIMIT = {
    "ax-h": "ax", "axr": "er", "bcl": "b", "dcl": "d", "gcl": "g", "pcl": "p", "tcl": "t",
    "kcl": "k", "dx": "d", "nx": "n", "eng": "ng", "hv": "hh", "ix": "ih", "ux": "uw", "q": "hh",
    "oh": "aa", "ia": "ih", "ea": "eh", "ua": "uh",
}  # fmt: skip

# Phones of the Montreal Forced Aligner's English dictionaries, without marks of length, stress and
# aspiration. Foreign phones map to the English one with the same lips.
_IPA = {
    "a": "aa", "aj": "ay", "aw": "aw", "ej": "ey", "ow": "ow", "ɔj": "oy", "əw": "ow",
    "aɪ": "ay", "aʊ": "aw", "eɪ": "ey", "oʊ": "ow", "əʊ": "ow", "ɔɪ": "oy",
    "ɪə": "ih", "eə": "eh", "ʊə": "uh", "e": "ey", "i": "iy", "o": "ow", "u": "uw",
    "æ": "ae", "ɐ": "ah", "ɑ": "aa", "ɒ": "aa", "ɔ": "ao", "ə": "ax", "ɚ": "er", "ɛ": "eh",
    "ɜ": "er", "ɝ": "er", "ɪ": "ih", "ɨ": "ih", "ʉ": "uw", "ʊ": "uh", "ʌ": "ah", "ø": "ow",
    "œ": "ow", "ɯ": "uw", "ɤ": "ah",
    "c": "k", "ɟ": "g", "ɡ": "g", "ɡb": "b", "kp": "p", "dʒ": "jh", "tʃ": "ch", "d͡ʒ": "jh",
    "t͡ʃ": "ch", "ts": "s", "dz": "z", "h": "hh", "ɦ": "hh", "x": "hh", "ç": "hh", "ʔ": "hh",
    "j": "y", "ɥ": "w", "ʍ": "w", "ð": "dh", "θ": "th", "ŋ": "ng", "ɱ": "m", "ɲ": "n", "ɳ": "n",
    "ɫ": "l", "ɭ": "l", "ʎ": "l", "ɹ": "r", "ɻ": "r", "ʁ": "r", "ʀ": "r", "ɾ": "d", "ɽ": "r",
    "ɖ": "d", "ʈ": "t", "ʃ": "sh", "ʂ": "sh", "ɕ": "sh", "ʒ": "zh", "ʐ": "zh", "ʑ": "zh",
    "β": "b", "ɸ": "f", "ʋ": "v", "q": "k",
}  # fmt: skip

_MARKS = "ˈˌːˑʰʲʷˠˤˀ˞ⁿˡ̚"


def arpabet_of(symbol: str) -> str | None:
    """Return the phone of the paper's alphabet, in lower case, for a symbol; None if unknown.

    Symbols are ARPAbet with or without stress digits, in either case; TIMIT; or the IPA of the
    Montreal Forced Aligner. Those of silence and noise, and the empty one, are ``'pau'``.
    """
    plain = symbol.strip()
    lowered = plain.lower()
    if not plain or lowered in _SILENT:
        return SILENCE
    latin = lowered.rstrip("0123456789")
    if latin in _VISEME_OF:
        return latin
    if latin in _TIMIT:
        return _TIMIT[latin]
    bare = _without_marks(plain)
    if bare in _IPA:
        return _IPA[bare]
    return bare if bare in _VISEME_OF else None


def viseme_of(symbol: str) -> str | None:
    """Return the viseme of a phone symbol, one of `VISEMES`; None if unknown."""
    phone = arpabet_of(symbol)
    return None if phone is None else _VISEME_OF[phone]


def viseme_label(viseme: str) -> str:
    """Return a viseme in the paper's notation, ``/b/ /p/ /m/``; empty for none."""
    return " ".join(f"/{phone}/" for phone in VISEME_PHONES.get(viseme, ()))


def _without_marks(symbol: str) -> str:
    """Remove marks that do not affect the lips: length, stress, aspiration, dental."""
    split = unicodedata.normalize("NFD", symbol)
    bare = "".join(
        letter for letter in split if letter not in _MARKS and not unicodedata.combining(letter)
    )
    # ç is a separate phone.
    return "ç" if symbol.startswith("ç") else bare


@dataclass(frozen=True)
class Span:
    """A labelled interval of time."""

    start: float
    end: float
    """`start`, `end`: [s], on the clock of the aligned sound."""
    label: str
    """A phone, a word or an emotion, as in its file."""

    @property
    def middle(self) -> float:
        """Midpoint [s]."""
        return (self.start + self.end) / 2


@dataclass(frozen=True)
class PhoneTrack:
    """Phones, words and emotions of a recording."""

    phones: tuple[Span, ...]
    """In order of time, including silences of the file."""
    words: tuple[Span, ...] = ()
    """Empty if the file has none."""
    emotions: tuple[Span, ...] = ()
    """Empty if the file has none."""
    duration: float = 0.0
    """[s]"""


def spans_at(spans: Sequence[Span], seconds: FloatArray) -> list[Span | None]:
    """Return the span at each time [s]; None where there is none."""
    places = np.searchsorted([span.start for span in spans], seconds, side="right") - 1
    return [
        spans[place] if place >= 0 and at < spans[place].end else None
        for place, at in zip(places.tolist(), seconds.tolist(), strict=True)
    ]


STEP_SECONDS = 0.02

LOUD_SHARE = 0.1
"""Level of a pause relative to the 95th percentile: 20 dB below speech."""

INCOMPLETE_SHARE = 0.45
"""Share of the sound outside all words above which a transcript is probably incomplete. Recordings
with all words leave 0.26 to 0.27 (breath and room), with half of them 0.59 to 0.72, with one word
0.80 to 0.98."""


def share_outside(samples: Float32Array, words: Sequence[Span], *, rate: int) -> float:
    """Return the share of the sound outside all words [0-1]. `samples`: (samples,), mono."""
    size = round(STEP_SECONDS * rate)
    steps = samples[: len(samples) // size * size].reshape(-1, size).astype(np.float64)
    if not len(steps):
        return 0.0
    level = np.sqrt(np.mean(steps**2, axis=1))
    loud = level > LOUD_SHARE * np.quantile(level, 0.95)  # others are pauses
    middle = (np.arange(len(loud)) + 0.5) * STEP_SECONDS
    inside = np.zeros(len(loud), dtype=np.bool_)
    for word in words:
        inside |= (middle >= word.start) & (middle < word.end)
    return float((loud & ~inside).sum() / max(int(loud.sum()), 1))
