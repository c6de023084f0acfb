"""Pronunciations of words: from a user's list in the format of the CMU dictionary, or by rules.

Unknown words are pronounced by letter-to-sound rules. Wrong vowels are tolerable, because only the
times of the phones and the motion of the lips matter.
"""

import re
from functools import lru_cache
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.text import read_text
from usdface.speech.phones import SILENCE, arpabet_of

# Pairs of pattern and phones; the first that matches at a letter is used. Lookahead and lookbehind
# distinguish open syllables (vowel, consonant, vowel) from closed ones.
_OPEN = r"(?=[bcdfghjklmnpqrstvwz][aeiouy])"
_MAGIC = r"(?=[bcdfgklmnpstvz]es?$)"
_SOFT = r"(?=[eiy])"
_RULES: tuple[tuple[str, str], ...] = (
    (r"augh(?=t)", "AO"), (r"ough(?=t)", "AO"), (r"ough", "OW"), (r"igh", "AY"),
    (r"eigh", "EY"), (r"aigh", "EY"), (r"ph", "F"), (r"gh(?=[aeiouy])", "G"), (r"gh", ""),
    (r"tch", "CH"), (r"sch(?=[aou])", "S K"), (r"sch", "SH"), (r"(?<=^)chr", "K R"),
    (r"ch", "CH"), (r"sh", "SH"), (r"th", "TH"), (r"wh", "W"), (r"^wr", "R"), (r"^kn", "N"),
    (r"^gn", "N"), (r"^ps", "S"), (r"^x", "Z"), (r"mb$", "M"), (r"mn$", "M"), (r"ck", "K"),
    (r"dg(?=e)", "JH"), (r"ng$", "NG"), (r"ng(?=s$)", "NG"), (r"n(?=k|x|q)", "NG"), (r"qu", "K W"),
    (r"tion", "SH AH N"), (r"ssion", "SH AH N"), (r"sion", "ZH AH N"), (r"cian", "SH AH N"),
    (r"tial", "SH AH L"), (r"cial", "SH AH L"), (r"cious", "SH AH S"), (r"tious", "SH AH S"),
    (r"ture(?=s?$)", "CH ER"), (r"sure(?=s?$)", "ZH ER"), (r"age(?=s?$)", "IH JH"),
    (r"ious", "IY AH S"), (r"ous(?=$|ly)", "AH S"), (r"sten$", "S AH N"),
    (r"(?<=[td])ed$", "IH D"), (r"(?<=[fkpsx])ed$", "T"), (r"(?<=[aeiouy].)ed$", "D"),
    (r"(?<=[a-z][a-z][bcdfgklmnprtvwz])ed$", "D"),
    (r"(?<=[sz])es$", "IH Z"), (r"(?<=[cs]h)es$", "IH Z"), (r"(?<=[a-z][bdglmnrv])es$", "Z"),
    (r"(?<=[a-z][fkpt])es$", "S"),
    (r"(?<=[bcdfgkpstz])le(?=s?$)", "AH L"), (r"(?<=[a-z])al(?=s?$|ly$)", "AH L"),
    (r"(?<=[a-z][a-z])en(?=s?$)", "AH N"), (r"(?<=[a-z][a-z])on(?=s?$)", "AH N"),
    (r"(?<=[a-z][a-z])an(?=s?$)", "AH N"), (r"(?<=[a-z][a-z])el(?=s?$)", "AH L"),
    (r"(?<=[a-z])ment(?=s?$)", "M AH N T"), (r"(?<=[a-z])ness$", "N AH S"),
    (r"(?<=[aeiouyr][a-z])er(?=s?$)", "ER"), (r"eer", "IH R"), (r"ear(?=[a-z])", "ER"),
    (r"ear", "IH R"), (r"air", "EH R"), (r"are(?=s?$)", "EH R"), (r"ire(?=s?$)", "AY ER"),
    (r"ore(?=s?$)", "AO R"), (r"ure(?=s?$)", "Y UH R"), (r"oor", "AO R"), (r"our", "AW ER"),
    (r"oar", "AO R"), (r"war", "W AO R"), (r"wor(?=[a-z])", "W ER"), (r"arr", "EH R"),
    (r"ar(?=[aeiou])", "EH R"), (r"ar$", "ER"), (r"ar", "AA R"), (r"er(?=[aeiou])", "EH R"),
    (r"err", "EH R"), (r"er", "ER"), (r"irr", "IH R"), (r"ir(?=[aeiou])", "IH R"), (r"ir", "ER"),
    (r"or$", "ER"), (r"or", "AO R"), (r"ur(?=[aeiou])", "Y UH R"), (r"ur", "ER"), (r"yr", "ER"),
    (r"ai", "EY"), (r"ay", "EY"), (r"au", "AO"), (r"aw", "AO"), (r"ea", "IY"), (r"ee", "IY"),
    (r"ei(?=n|t)", "AY"), (r"ei", "IY"), (r"ey$", "IY"), (r"ey", "EY"), (r"eu", "UW"),
    (r"ew", "UW"), (r"ie$", "IY"), (r"ies$", "IY Z"), (r"ied$", "IY D"), (r"ie", "IY"),
    (r"oa", "OW"), (r"oi", "OY"), (r"oy", "OY"), (r"oo(?=k)", "UH"), (r"oo", "UW"),
    (r"ow(?=n|l|er|d)", "AW"), (r"ow", "OW"), (r"ou", "AW"), (r"oe$", "OW"), (r"ue(?=s?$)", "UW"),
    (r"ui", "UW"), (r"uy", "AY"),
    (r"ia$", "IY AH"), (r"io$", "IY OW"), (r"io", "IY OW"), (r"iu", "IY AH"), (r"ia", "IY AH"),
    (r"a" + _MAGIC, "EY"), (r"e(?=[bcdfgklmnpstvz]es?$)", "IY"),
    (r"i(?=ne$|te$|ve$|ce$)(?<=[a-z][a-z][a-z]i)", "IH"), (r"i" + _MAGIC, "AY"),
    (r"o" + _MAGIC, "OW"), (r"u" + _MAGIC, "UW"), (r"y" + _MAGIC, "AY"),
    (r"a(?=l[kdt])", "AO"), (r"a(?=ll)", "AO"), (r"^a(?=[bcdfglnpst]\w{3})", "AH"), (r"a$", "AH"),
    (r"(?<=w)a(?=[a-z])", "AA"), (r"a(?=[bdgklmnptv][ei]\w)", "EY"), (r"a", "AE"),
    (r"^e(?=[a-z])(?=[bcdfglmnprstv][aeiou])", "IH"), (r"e(?=s?$)", ""), (r"e(?=ly$)", ""),
    (r"e", "EH"),
    (r"i$", "IY"), (r"i(?=nd$|ld$)", "AY"), (r"^i" + _OPEN, "AY"), (r"i", "IH"),
    (r"o(?=ld|lt|ll|st$)", "OW"), (r"o(?=s?$)", "OW"), (r"^co(?=n|m)", "K AH"),
    (r"o" + _OPEN, "OW"), (r"o(?=n$|m$)", "AH"), (r"o", "AA"),
    (r"^u(?=ni)", "Y UW"), (r"(?<=[bcfghkmpv])u" + _OPEN, "Y UW"), (r"u" + _OPEN, "UW"),
    (r"u(?=s?$)", "UW"), (r"u(?=ll|sh$|t$)(?<=[bfp]u)", "UH"), (r"u", "AH"),
    (r"^y", "Y"), (r"(?<=^[a-z])y$", "AY"), (r"(?<=^[a-z][a-z])y$", "AY"), (r"y$", "IY"),
    (r"y(?=[aeiou])", "Y"), (r"y", "IH"),
    (r"c" + _SOFT, "S"), (r"cc" + _SOFT, "K S"), (r"cc", "K"), (r"c", "K"),
    (r"gg", "G"), (r"g(?=e[a-z]?$|i[aou]|y|en)", "JH"), (r"ge(?=[ao])", "JH"), (r"g", "G"),
    (r"ss", "S"), (r"s(?=m$)", "Z"), (r"(?<=[bdgmnlrvwaeiou])s$", "Z"),
    (r"(?<=[aeiou])s(?=[aeiou])", "Z"), (r"s", "S"), (r"x", "K S"), (r"zz", "Z"), (r"z", "Z"),
    (r"j", "JH"), (r"q", "K"), (r"h(?=$|[bcdfgjklmnpqrstvwxz])", ""), (r"h", "HH"),
    (r"(bb|b)", "B"), (r"(dd|d)", "D"), (r"(ff|f)", "F"), (r"(kk|k)", "K"), (r"(ll|l)", "L"),
    (r"(mm|m)", "M"), (r"(nn|n)", "N"), (r"(pp|p)", "P"), (r"(rr|r)", "R"), (r"(tt|t)", "T"),
    (r"(vv|v)", "V"), (r"w$", ""), (r"w(?=[bcdfgjklmnpqrstvxz])", ""), (r"(ww|w)", "W"),
    (r"'", ""),
)  # fmt: skip

_SPELLED = {
    "a": "EY", "b": "B IY", "c": "S IY", "d": "D IY", "e": "IY", "f": "EH F", "g": "JH IY",
    "h": "EY CH", "i": "AY", "j": "JH EY", "k": "K EY", "l": "EH L", "m": "EH M", "n": "EH N",
    "o": "OW", "p": "P IY", "q": "K Y UW", "r": "AA R", "s": "EH S", "t": "T IY", "u": "Y UW",
    "v": "V IY", "w": "D AH B AH L Y UW", "x": "EH K S", "y": "W AY", "z": "Z IY",
}  # fmt: skip


@lru_cache(maxsize=1)
def _compiled() -> tuple[tuple[re.Pattern[str], tuple[str, ...]], ...]:
    return tuple((re.compile(rule), tuple(phones.split())) for rule, phones in _RULES)


def phones_of_letters(word: str) -> tuple[str, ...]:
    """Guess the phones of a word: ARPAbet in upper case without stress, at least one.

    Other characters than the letters a to z and apostrophes are ignored. A word without a vowel,
    such as ``bbc``, is spelled.
    """
    letters = re.sub(r"[^a-z']", "", word.lower())
    plain = letters.replace("'", "")
    if not plain:
        raise ValueError(f"{word!r} has no letter a to z")
    if not re.search(r"[aeiouy]", plain):
        return tuple(phone for letter in plain for phone in _SPELLED[letter].split())
    if letters.endswith("'s") and len(letters) > 2:
        return _possessive(phones_of_letters(letters[:-2]))
    pronounced: list[str] = []
    place = 0
    while place < len(letters):
        for rule, phones in _compiled():
            match = rule.match(letters, place)
            if match and match.end() > place:
                pronounced += phones
                place = match.end()
                break
        else:
            place += 1
    return tuple(pronounced) or tuple(_SPELLED[plain[0]].split())


def _possessive(phones: tuple[str, ...]) -> tuple[str, ...]:
    if phones[-1] in ("S", "Z", "SH", "ZH", "CH", "JH"):
        return (*phones, "IH", "Z")
    return (*phones, "S" if phones[-1] in ("P", "T", "K", "F", "TH") else "Z")


LARGEST_DICTIONARY_BYTES = 64 << 20


def read_dictionary(path: Path) -> dict[str, tuple[str, ...]]:
    """Read pronunciations, one per line: ``kvothe  K V OW TH``.

    Stress digits are removed, lines that begin with ``;;;`` or ``#`` are comments, and the first of
    several entries for a word is used.

    Returns ARPAbet in upper case, by word in lower case.
    """
    pronunciations: dict[str, tuple[str, ...]] = {}
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
                + (f"the phone {wrong[0]!r}, which is not ARPAbet" if wrong else "no phones")
                + "; write the word, then its phones, as in: kvothe  K V OW TH"
            )
        name = re.sub(r"\(\d+\)$", "", word.lower())
        phones = tuple(phone.upper() for phone in known if phone is not None)
        pronunciations.setdefault(name, phones)
    return pronunciations
