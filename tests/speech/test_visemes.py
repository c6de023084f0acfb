"""Symbols of every alphabet look like one of the paper's 15 visemes."""

import pytest

from usdface.speech.phones import VISEME_PHONES, VISEMES, arpabet_of, viseme_label, viseme_of

ARPABET = (
    "AA AE AH AO AW AY B CH D DH EH ER EY F G HH IH IY JH K L M N NG OW OY P R S SH T TH UH UW V W "
    "Y Z ZH"
).split()
TIMIT = (
    "iy ih eh ey ae aa aw ay ah ao oy ow uh uw ux er ax ix axr ax-h jh ch b d g p t k dx s sh z zh "
    "f th v dh m n ng em nx en eng l r w y hh hv el bcl dcl gcl pcl tcl kcl q pau epi h#"
).split()
MFA = (
    "a aj aw b bʲ c cʰ cʷ d dʒ dʲ d̪ e ej f fʲ h i iː j k kʰ kʷ l m mʲ m̩ n n̩ o ow p pʰ pʲ pʷ "
    "s t tʃ tʰ tʲ tʷ t̪ u uː v vʲ w z æ ç ð ŋ ɐ ɑ ɑː ɒ ɒː ɔ ɔj ə əw ɚ ɛ ɛː ɜ ɜː ɝ ɟ ɡ ɡʷ ɪ ɫ ɫ̩ ɱ ɲ "
    "ɹ ɾ ɾʲ ɾ̃ ʃ ʈ ʉ ʉː ʊ ʋ ʎ ʒ ʔ θ spn"
).split()


def test_there_are_the_15_visemes_of_the_paper_and_no_phone_is_in_two() -> None:
    phones = [phone for group in VISEME_PHONES.values() for phone in group]
    assert len(VISEMES) == 15
    assert len(phones) == len(set(phones))
    assert all(phones[0] == name for name, phones in VISEME_PHONES.items())


@pytest.mark.parametrize("symbol", ARPABET + TIMIT + MFA)
def test_every_symbol_of_the_alphabets_is_a_viseme(symbol: str) -> None:
    assert viseme_of(symbol) in VISEMES


@pytest.mark.parametrize("symbol", ARPABET)
def test_stress_and_case_change_nothing(symbol: str) -> None:
    expected = viseme_of(symbol)
    assert viseme_of(symbol.lower()) == expected
    assert viseme_of(f"{symbol}0") == viseme_of(f"{symbol}2") == expected


@pytest.mark.parametrize("mark", ["", " ", "SIL", "sil", "<s>", "sp", "spn", "h#", "pau", "<eps>"])
def test_every_mark_of_silence_is_a_mouth_at_rest(mark: str) -> None:
    assert viseme_of(mark) == "pau"


def test_a_closure_looks_like_its_stop_and_ipa_like_arpabet() -> None:
    pairs = {"bcl": "B", "kcl": "K", "ʃ": "SH", "tʃ": "CH", "ɹ": "R", "ej": "EY", "θ": "TH"}
    pairs |= {"ŋ": "NG", "pʰ": "P", "tʲ": "T", "iː": "IY", "ʊ": "UH", "j": "Y", "m̩": "M"}
    assert {symbol: viseme_of(symbol) for symbol in pairs} == {
        symbol: viseme_of(same) for symbol, same in pairs.items()
    }


@pytest.mark.parametrize("symbol", ["?", "xyz", "ł", "hello"])
def test_an_unknown_symbol_is_no_viseme(symbol: str) -> None:
    assert viseme_of(symbol) is None
    assert arpabet_of(symbol) is None


def test_labels_read_as_in_the_paper() -> None:
    assert viseme_label("b") == "/b/ /p/ /m/"
    assert viseme_label("nothing") == ""
