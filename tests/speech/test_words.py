"""Transcripts become words, and words that no dictionary has become phones."""

import random
import re
from pathlib import Path

import pytest

from usdface.core.errors import InputError
from usdface.speech.forced_alignment import spoken_words
from usdface.speech.phones import viseme_of
from usdface.speech.pronunciation import phones_of_letters, read_dictionary


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Who's there?  [laughs] <noise> (off)", "who's there"),
        ("Café, naïve", "cafe naive"),
        ("It’s 21 of 1,305", "it's twenty one of one thousand three hundred five"),
        ("3.14 & 007", "three point one four and zero zero seven"),
        ("'quoted' rock'n'roll", "quoted rock'n'roll"),
        ("well-known", "well known"),
    ],
)
def test_transcripts_are_read_as_they_are_said(text: str, words: str) -> None:
    assert spoken_words(text) == tuple(words.split())


@pytest.mark.parametrize("text", ["", "  ", "[music]", "...", "привет"])
def test_a_transcript_without_words_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="has no word;"):
        spoken_words(text)


def edits(left: list[str], right: list[str]) -> int:
    row = list(range(len(right) + 1))
    for i, a in enumerate(left, 1):
        new = [i]
        for j, b in enumerate(right, 1):
            new.append(min(row[j] + 1, new[-1] + 1, row[j - 1] + (a != b)))
        row = new
    return row[-1]


def test_guesses_agree_with_a_dictionary_in_six_of_seven_visemes() -> None:
    pocketsphinx = pytest.importorskip("pocketsphinx")
    lines = Path(pocketsphinx.get_model_path("en-us/cmudict-en-us.dict")).read_text("utf-8")
    entries = [line.split() for line in lines.splitlines()]
    entries = [entry for entry in entries if re.fullmatch("[a-z]{3,}", entry[0])]
    phones = visemes = count = 0
    for word, *said in random.Random(0).sample(entries, 1000):
        guess = phones_of_letters(word)
        phones += edits(list(guess), said)
        visemes += edits([str(viseme_of(p)) for p in guess], [str(viseme_of(p)) for p in said])
        count += len(said)
    assert phones / count < 0.22
    assert visemes / count < 1 / 7


def test_names_and_spelled_words_and_possessives() -> None:
    assert phones_of_letters("kvothe") == ("K", "V", "AA", "TH")
    assert phones_of_letters("bbc") == ("B", "IY", "B", "IY", "S", "IY")
    assert phones_of_letters("kvothe's")[-1] == "S"
    assert phones_of_letters("gandalf's")[-1] == "S"
    with pytest.raises(ValueError, match="no letter a to z"):
        phones_of_letters("'")


def test_a_users_dictionary_is_read_and_its_faults_are_named(tmp_path: Path) -> None:
    path = tmp_path / "names.dict"
    path.write_text(";;; ours\n# too\nKvothe  K V OW1 TH\nKvothe(2) K V AA TH\n", "utf-8")
    assert read_dictionary(path) == {"kvothe": ("K", "V", "OW", "TH")}
    path.write_text("kvothe K V QQ TH\n", "utf-8")
    with pytest.raises(InputError, match=r"line 1: 'kvothe' has the phone 'QQ', which is not ARPA"):
        read_dictionary(path)
    path.write_text("kvothe\n", "utf-8")
    with pytest.raises(InputError, match=r"line 1: 'kvothe' has no phones"):
        read_dictionary(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_dictionary(tmp_path / "none")
