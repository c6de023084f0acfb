"""Align a transcript with its sound, and write the phones."""

from pathlib import Path

from usdface.core.assets import Video
from usdface.core.errors import InputError, as_input_error
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import is_usd_name
from usdface.core.text import counted, read_text
from usdface.media.film.sound import read_audio
from usdface.runner.result import StepResult
from usdface.specs.capture import PhonesSpec
from usdface.speech.forced_alignment import (
    SPEECH_SAMPLE_RATE,
    UNCERTAIN_SCORE,
    PhoneAlignment,
    align_phones,
    spoken_words,
)
from usdface.speech.phones import INCOMPLETE_SHARE, PhoneTrack, Span, share_outside, viseme_of
from usdface.speech.pronunciation import read_dictionary
from usdface.speech.track_files import write_phone_track
from usdface.usdio.take.read import read_first_frame

LARGEST_TRANSCRIPT_BYTES = 1 << 20
"""The size of a day of speech."""

NAMED_WORDS = 8
"""Words listed in a note; further ones are counted."""


def run(spec: PhonesSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Align the words with the sound and write the phones."""
    text = spec.text
    if spec.transcript is not None:
        text = read_text(spec.transcript, LARGEST_TRANSCRIPT_BYTES)
    words = _words(spec, text or "")
    pronunciations = {} if spec.dictionary is None else read_dictionary(spec.dictionary)
    file, video = _find_sound(spec)
    samples = read_audio(file, rate=SPEECH_SAMPLE_RATE)
    found = align_phones(
        samples, words, pronunciations=pronunciations, progress=part(progress, 0.1, 0.95)
    )
    outside = share_outside(samples, found.track.words, rate=SPEECH_SAMPLE_RATE)
    track = found.track if video is None else _on_take_clock(found.track, video)
    write_phone_track(spec.out, track, origin=provenance.metadata)
    spoken = [span for span in track.phones if viseme_of(span.label) != "pau"]
    visemes = sorted({viseme_of(span.label) or "" for span in spoken})
    return StepResult(
        (spec.out,),
        f"{len(spoken)} phones of {len(track.words)} words in {track.duration:.1f} s, "
        f"{len(visemes)} of the 14 visemes of speech",
        tuple(_notes(found, outside)),
        {
            "phones": len(spoken),
            "sound_outside_words": round(outside, 3),
            "words": len(track.words),
            "visemes": visemes,
            "score": round(found.score, 2),
            "beam": found.beam,
            "guessed": {word: " ".join(phones) for word, phones in found.guessed.items()},
            "doubtful_words": [
                {"word": span.label, "seconds": round(span.start, 2)}
                for span in found.uncertain_words
            ],
        },
    )


def _words(spec: PhonesSpec, text: str) -> tuple[str, ...]:
    if spec.transcript is None:
        return spoken_words(text)
    with as_input_error(spec.transcript, of=InputError):
        return spoken_words(text)


def _find_sound(spec: PhonesSpec) -> tuple[Path, Video | None]:
    """Return the file of the sound, and the video whose clock it is on, None if on the take's."""
    if not is_usd_name(spec.audio):
        return spec.audio, None
    take = read_first_frame(spec.audio)
    if take.audio is not None:
        return take.audio, None
    if take.video is None:
        raise InputError(
            f"{spec.audio}: the take has no sound and no video; ingest it with --audio or "
            "--video, or give the sound file"
        )
    return take.video.file, take.video


def _on_take_clock(track: PhoneTrack, video: Video) -> PhoneTrack:
    """Convert spans to take time, without those before its first frame."""

    def moved(spans: tuple[Span, ...]) -> tuple[Span, ...]:
        placed = (
            Span(video.take_time(span.start), video.take_time(span.end), span.label)
            for span in spans
        )
        return tuple(Span(max(s.start, 0.0), s.end, s.label) for s in placed if s.end > 0)

    return PhoneTrack(
        moved(track.phones),
        moved(track.words),
        moved(track.emotions),
        max(video.take_time(track.duration), 0.0),
    )


def _notes(found: PhoneAlignment, outside: float) -> list[str]:
    notes = []
    if outside > INCOMPLETE_SHARE:
        notes.append(
            f"{outside:.0%} of the sound lies outside the words: the transcript is incomplete or "
            "of another recording; write down every word"
        )
    if found.guessed:
        shown = [f"{word} ({' '.join(phones)})" for word, phones in found.guessed.items()]
        notes.append(
            "in no dictionary, and pronounced by letter-to-sound rules: "
            f"{counted(shown, 'word', most=NAMED_WORDS)}; give their phones with --dictionary"
        )
    if found.score < UNCERTAIN_SCORE:
        notes.append(
            f"the words fit the sound poorly (score {found.score:.0f} a frame): check the phones "
            "before using them"
        )
    if found.beam:
        notes.append(
            "the alignment needed a wider search: the transcript may lack spoken words or hold "
            "others; check it"
        )
    if found.uncertain_words:
        shown = [f"{span.label} ({span.start:.1f} s)" for span in found.uncertain_words]
        notes.append(f"poorly aligned: {counted(shown, 'word', most=NAMED_WORDS)}")
    return notes
