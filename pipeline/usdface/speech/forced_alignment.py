"""Forced alignment of a transcript to sound with pocketsphinx.

The times of the words are searched first, then those of the phones within them. A wrong transcript
gives a path too, but with a low acoustic score.
"""

import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import Float32Array
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.speech.phones import PhoneTrack, Span
from usdface.speech.pronunciation import phones_of_letters

if TYPE_CHECKING:
    from pocketsphinx import Decoder


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
"""Characters; longer numbers are read digit by digit."""
_SIGNS = {"&": " and ", "%": " percent ", "@": " at ", "+": " plus "}


def spoken_words(text: str) -> tuple[str, ...]:
    """Return the words of a transcript in lower case, with numbers spelled out.

    Remarks in brackets, such as ``[laughs]`` or ``<noise>``, are removed.
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
            f"the transcript {text.strip()[:40]!r} has no word; write the spoken words in Latin "
            "letters"
        )
    return spoken


def _without_remarks(text: str) -> str:
    """Remove text in brackets, in linear time also with many unclosed ones."""
    kept, at = [], 0
    unclosed: set[str] = set()
    for match in _OPENING.finditer(text):
        bracket, start = match.group(), match.start()
        if start < at or bracket in unclosed:
            continue
        end = text.find(_CLOSED_BY[bracket], start)
        if end < 0:
            unclosed.add(bracket)
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


SPEECH_SAMPLE_RATE = 16000
"""Samples per second of the acoustic model in the wheel."""

FRAME_SECONDS = 0.01

BEAMS = ((1e-48, 7e-29), (1e-120, 1e-100), (1e-200, 1e-200))
"""Beam widths (relative likelihoods) within and between words, tried in order until a path is
found."""

UNCERTAIN_SCORE = -38.0
WRONG_SCORE = -41.0
"""Mean score per frame of speech, at most 0. Recordings with their own transcripts give -20 to -33,
with those of others -58 to -67. The limit is at a third of the way, because transcripts in another
language score higher than those of another recording."""

UNCERTAIN_WORD_SCORE = -75.0
"""Score per frame below which a word is probably wrong."""

PEAK_LEVEL = 0.7
LEAST_PEAK_LEVEL = 1e-4
"""Peak level below which a recording is silent [full scale]."""

_DITHER_STEPS = 3  # 16-bit steps of noise, because digital silence breaks the model's logarithms
_NO_WORDS = ("<s>", "</s>", "<sil>", "[NOISE]", "[SPEECH]")


@dataclass(frozen=True)
class PhoneAlignment:
    """Times of the phones, with measures of reliability."""

    track: PhoneTrack
    """Phones in ARPAbet, silence as ``SIL``."""
    score: float
    """Mean over the frames of speech; see `WRONG_SCORE`."""
    guessed: dict[str, tuple[str, ...]]
    """Words missing from the dictionaries, with guessed pronunciations."""
    uncertain_words: tuple[Span, ...]
    """Words with a score below `UNCERTAIN_WORD_SCORE`."""
    beam: int
    """Index in `BEAMS` of the first that found a path; above 0, the transcript may not fit."""


def align_phones(
    samples: Float32Array,
    words: tuple[str, ...],
    *,
    pronunciations: Mapping[str, tuple[str, ...]] | None = None,
    progress: Progress = silent,
) -> PhoneAlignment:
    """Find the phones of a transcript in a recording.

    Parameters
    ----------
    samples : (samples,) float32 array
        Mono, at `SPEECH_SAMPLE_RATE` [-1 to 1].
    words : tuple of str
        The transcript in lower case; see `spoken_words`.
    pronunciations : mapping of str to tuple of str, optional
        ARPAbet of words that the model's dictionary lacks or pronounces otherwise.
    """
    sound = _as_pcm(samples)
    user_words = {} if pronunciations is None else pronunciations
    for number, beam in enumerate(BEAMS):
        progress(number / len(BEAMS), f"looking for the words, beam {number + 1} of {len(BEAMS)}")
        decoder = _decoder(*beam)
        guessed = _teach(decoder, words, user_words)
        decoder.set_align_text(" ".join(words))
        if not _decode(decoder, sound) or decoder.hyp() is None:
            continue
        aligned = (_plain(segment.word) for segment in decoder.seg())
        if [word for word in aligned if word not in _NO_WORDS] != list(words):
            continue
        progress((number + 0.5) / len(BEAMS), "looking for the phones")
        decoder.set_alignment()
        # hyp() after this pass crashes pocketsphinx; get_alignment() is the result.
        if not _decode(decoder, sound) or decoder.get_alignment() is None:
            continue
        return _scored(decoder, guessed, number, duration=len(samples) / SPEECH_SAMPLE_RATE)
    raise InputError(
        f"the words {' '.join(words[:6])!r}... cannot be found in the sound in this order; is it "
        "the transcript of another recording? It must contain every spoken word"
    )


def _decoder(beam: float, word_beam: float) -> "Decoder":
    try:
        from pocketsphinx import Decoder
    except ImportError as error:
        raise InputError(
            "aligning speech needs pocketsphinx; install usdface[speech], or give a TextGrid of "
            "another aligner to `usdface select --phones`"
        ) from error
    # bestpath needs a lattice, which alignment does not have.
    return Decoder(
        lm=None,
        loglevel="FATAL",
        samprate=SPEECH_SAMPLE_RATE,
        beam=beam,
        pbeam=beam,
        wbeam=word_beam,
        bestpath=False,
    )


def _teach(
    decoder: "Decoder", words: tuple[str, ...], user_words: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    """Add missing words to the decoder's dictionary; return the guessed ones."""
    guessed = {}
    for word in dict.fromkeys(words):
        known = decoder.lookup_word(word)
        if word in user_words:
            phones = user_words[word]
            if known is not None and known.split() == list(phones):
                continue
            # A second pronunciation of a known word is another entry; the path takes the better.
            name = word if known is None else f"{word}(99)"
            decoder.add_word(name, " ".join(phones), True)
        elif known is None:
            guessed[word] = phones_of_letters(word)
            decoder.add_word(word, " ".join(guessed[word]), True)
    return guessed


def _decode(decoder: "Decoder", sound: bytes) -> bool:
    try:
        decoder.start_utt()
        decoder.process_raw(sound, full_utt=True)
        decoder.end_utt()
    except RuntimeError:
        return False
    return True


def _plain(word: str) -> str:
    """Remove the number of an alternative pronunciation, as in ``word(2)``."""
    return word[: word.rindex("(")] if word.endswith(")") and "(" in word[1:] else word


def _scored(
    decoder: "Decoder", guessed: dict[str, tuple[str, ...]], beam: int, *, duration: float
) -> PhoneAlignment:
    phones: list[Span] = []
    words: list[Span] = []
    doubtful: list[Span] = []
    total, frames = 0.0, 0
    for word, entries in _entries(decoder):
        phones += [phone for phone, _ in entries if phone.end > phone.start]
        if word in _NO_WORDS:
            continue
        span = Span(entries[0][0].start, entries[-1][0].end, word)
        words.append(span)
        score = sum(score for _, score in entries)
        count = max(round((span.end - span.start) / FRAME_SECONDS), 1)
        total, frames = total + score, frames + count
        if score / count < UNCERTAIN_WORD_SCORE:
            doubtful.append(span)
    mean = total / max(frames, 1)
    if mean < WRONG_SCORE:
        raise InputError(
            f"the transcript does not fit the sound: its phones score {mean:.1f} a frame, below "
            f"{WRONG_SCORE:g}; correct transcripts score -20 to -33. Is it the transcript of "
            "another recording, or in another language?"
        )
    track = PhoneTrack(tuple(phones), tuple(words), (), duration)
    return PhoneAlignment(track, mean, guessed, tuple(doubtful), beam)


def _entries(decoder: "Decoder") -> Iterator[tuple[str, list[tuple[Span, float]]]]:
    for word in decoder.get_alignment():
        entries = [
            (
                Span(
                    phone.start * FRAME_SECONDS,
                    (phone.start + phone.duration) * FRAME_SECONDS,
                    phone.name,
                ),
                float(phone.score),
            )
            for phone in word
        ]
        if entries:
            yield _plain(word.name), entries


def _as_pcm(samples: Float32Array) -> bytes:
    peak = float(np.abs(samples).max(initial=0.0))
    if peak < LEAST_PEAK_LEVEL:
        raise InputError(
            f"the sound is silent (its peak is {peak:.1g} of full scale): there is no speech to "
            "align; is it the right channel?"
        )
    scaled = samples.astype(np.float64) * (PEAK_LEVEL / peak * 32767)
    noise = np.random.default_rng(0).integers(-_DITHER_STEPS, _DITHER_STEPS + 1, len(samples))
    return (scaled + noise).astype("<i2").tobytes()
