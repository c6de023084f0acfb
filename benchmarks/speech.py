"""Phones of recorded speech compared with another aligner, and refusal of wrong transcripts."""

import time
from difflib import SequenceMatcher
from itertools import product

import numpy as np

from tests.conftest import SHARED_DATA
from usdface.core.errors import InputError
from usdface.media.film.sound import read_audio
from usdface.speech.forced_alignment import PhoneAlignment, align_phones, spoken_words
from usdface.speech.phones import PhoneTrack, Span, arpabet_of, viseme_of
from usdface.speech.track_files import read_phone_track

NAMES = ("acoustic_corpus", "cold_corpus", "cold_corpus3")


def run() -> None:
    """Print differences of phone midpoints, and the transcripts that are refused."""
    source = SHARED_DATA / "speech_mfa"
    if not source.is_dir():
        print(f"skipped: no speech_mfa in {SHARED_DATA}")
        return
    sounds = {name: read_audio(source / "wav" / f"{name}.wav") for name in NAMES}
    words = {
        name: spoken_words((source / "lab" / f"{name}.lab").read_text("utf-8")) for name in NAMES
    }
    print(
        "| recording | phones compared | median [ms] | 90 % [ms] | score "
        "| processor seconds for one |"
    )
    print("|---|---|---|---|---|---|")
    pooled = []
    for name in NAMES:
        begun = time.process_time()
        found = align_phones(sounds[name], words[name])
        spent = (time.process_time() - begun) / (len(sounds[name]) / 16000)
        theirs = read_phone_track(source / "textgrid" / f"{name}.TextGrid")
        errors = 1000 * _midpoint_errors(found, theirs)
        pooled.append(errors)
        print(
            f"| {name} | {len(errors)} of {len(_said(theirs))} | {np.median(errors):.0f} | "
            f"{np.percentile(errors, 90):.0f} | {found.score:.0f} | {spent:.3f} |"
        )
    every = np.concatenate(pooled)
    print(f"| all | {len(every)} | {np.median(every):.0f} | {np.percentile(every, 90):.0f} | | |")
    refused = sum(_is_refused(sounds[a], words[b]) for a, b in product(NAMES, NAMES) if a != b)
    print(f"\nTranscripts of another recording refused: {refused} of 6")


def _said(track: PhoneTrack) -> list[Span]:
    return [span for span in track.phones if viseme_of(span.label) != "pau"]


def _midpoint_errors(found: PhoneAlignment, theirs: PhoneTrack) -> np.ndarray:
    """Return distances between midpoints of phones that both aligners found, in order [s]."""
    ours, others = _said(found.track), _said(theirs)
    blocks = SequenceMatcher(
        None,
        [arpabet_of(span.label) for span in ours],
        [arpabet_of(span.label) for span in others],
        autojunk=False,
    ).get_matching_blocks()
    return np.array(
        [abs(ours[i + k].middle - others[j + k].middle) for i, j, n in blocks for k in range(n)]
    )


def _is_refused(sound: np.ndarray, words: tuple[str, ...]) -> bool:
    try:
        align_phones(sound, words)
    except InputError:
        return True
    return False
