"""Measure the time offset and clock drift of a take's video, and store them in the take."""

import logging
from dataclasses import dataclass
from fractions import Fraction

from usdface.core.assets import Take, Video
from usdface.core.errors import CheckFailedError, InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.rates import day_seconds, frames_of, label_rate
from usdface.media.charts.alignment import AlignmentPage, ShiftMark, draw_alignment
from usdface.media.film.sound import read_audio
from usdface.media.film.video import VideoReader, open_video
from usdface.media.picture.image import write_image
from usdface.numerics.timing.audio_alignment import SoundAlignment, align_sounds
from usdface.runner.origin import REFUSED_SUFFIX, make_provenance, provenance_of
from usdface.runner.result import StepResult
from usdface.specs.capture import AlignSpec
from usdface.usdio.take.read import read_first_frame
from usdface.usdio.take.write import VideoSync, write_video_sync


@dataclass(frozen=True)
class TimecodeShift:
    """Take time at which a video starts, from the timecode of both."""

    offset: float | None
    """[s]; None if the timecodes cannot be compared."""
    tolerance: float = 0.0
    """Largest error of the offset: a label names a frame, not a moment within it [s]."""
    reason: str = ""
    """Why they cannot be compared."""


def timecode_shift(
    take_start: str,
    take_rate: Fraction,
    video_start: str,
    video_rate: Fraction | None,
    *,
    first_picture: float = 0.0,
) -> TimecodeShift:
    """Compare the timecode of a take's first frame with that of a video's first picture.

    SMPTE labels, empty if there are none; a video's rate is None if it varies. `first_picture`: its
    time on the video's clock [s].
    """
    missing = [name for name, label in (("take", take_start), ("video", video_start)) if not label]
    if missing:
        verb = "carries" if len(missing) == 1 else "carry"
        return TimecodeShift(None, reason=f"the {' and the '.join(missing)} {verb} no timecode")
    if video_rate is None:
        return TimecodeShift(None, reason="the video's frames are not evenly spaced")
    drop = tuple(";" in label for label in (take_start, video_start))
    if drop[0] != drop[1] or take_rate.denominator != video_rate.denominator:
        # 23.976 and 24 both count 24 labels a second, but their seconds differ.
        return TimecodeShift(
            None,
            reason=f"timecode at {_named(take_rate, drop[0])} and {_named(video_rate, drop[1])} "
            "does not count the same seconds",
        )
    try:
        take_time = frames_of(take_start, take_rate) / take_rate
        video_time = frames_of(video_start, video_rate) / video_rate
    except InputError as error:
        return TimecodeShift(None, reason=str(error))
    day = day_seconds(take_rate, drop=drop[0])
    difference = (video_time - take_time + day / 2) % day - day / 2  # across midnight too
    tolerance = sum((label_rate(rate)[1] / rate for rate in (take_rate, video_rate)), Fraction(0))
    return TimecodeShift(float(difference) - first_picture, float(tolerance))


def _named(rate: Fraction, drop: bool) -> str:
    return f"{float(rate):.6g}{' drop frame' if drop else ''}"


log = logging.getLogger(__name__)

_SAMPLE_RATE = 16000
"""Samples per second at which sounds are compared: speech has no energy above 7 kHz."""

UNCHECKED_CONFIDENCE = 0.5
"""Confidence of a timecode without confirmation by sound, as clocks may not have been set."""


@dataclass(frozen=True)
class Evidence:
    """Measured offsets of a video."""

    sound: SoundAlignment | None
    no_sound: str
    """Why there is no sound to compare."""
    timecode: TimecodeShift

    @property
    def trusted(self) -> SoundAlignment | None:
        """The offset by sound, if it is reliable."""
        return None if self.sound is None or self.sound.warnings else self.sound

    @property
    def sound_problem(self) -> str:
        """Why the sound is missing or unreliable."""
        return self.no_sound if self.sound is None else "; ".join(self.sound.warnings)


@dataclass(frozen=True)
class Decision:
    """The offset to write, or the reason for writing none."""

    sync: VideoSync | None
    source: str
    """Source of the offset, or why none was accepted."""
    notes: tuple[str, ...] = ()


def run(spec: AlignSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Measure the video's offset and drift, draw the evidence, and write them if reliable."""
    picture = spec.picture_path()
    if spec.picture is None and picture.exists() and provenance_of(picture) is None:
        raise InputError(
            f"{picture}: was not written by usdface; move it, or name another --picture"
        )
    take = read_first_frame(spec.take)
    if take.video is None:
        raise InputError(f"{spec.take}: has no video to align; ingest the capture with --video")
    evidence = _gather(take, take.video, part(progress, 0.05, 0.9))
    decision = decide(spec, evidence)
    progress(0.9, f"writing {picture.name}")
    page = _page(take, evidence, decision)
    if decision.sync is None:
        refused = Provenance(step=f"{spec.step}{REFUSED_SUFFIX}")
        write_image(picture, draw_alignment(page), metadata=refused.metadata)
        raise CheckFailedError(
            f"{spec.take}: the video cannot be aligned: {decision.source}. Look at {picture}; set "
            "the offset with --offset SECONDS"
        )
    write_video_sync(spec.take, decision.sync)
    # The take's hash has changed: the picture, written last, stores the new one.
    made = make_provenance(spec)
    write_image(picture, draw_alignment(page), metadata=made.metadata)
    log.info("%s: %s", spec.take, page.verdict)
    return StepResult(
        outputs=(spec.take, picture),
        summary=f"{take.name}: {page.verdict}",
        notes=decision.notes,
        figures=_figures(decision, evidence),
    )


def decide(spec: AlignSpec, evidence: Evidence) -> Decision:
    """Choose the offset: set by hand, by timecode or by sound."""
    if spec.offset is not None:
        sync = VideoSync(spec.offset, spec.drift or 0.0, 1.0)
        return Decision(sync, "set by hand", _difference(spec.offset, evidence))
    sound, labels = evidence.trusted, evidence.timecode
    if spec.by == "timecode" and labels.offset is None:
        return Decision(None, labels.reason)
    if spec.by == "sound" or labels.offset is None:
        if sound is None:
            return Decision(None, evidence.sound_problem)
        sync = VideoSync(sound.offset, 1e6 * sound.drift, sound.confidence)
        return Decision(sync, "by sound", _difference(sound.offset, evidence))
    if sound is None:
        sync = VideoSync(labels.offset, 0.0, UNCHECKED_CONFIDENCE)
        note = f"the timecode could not be checked against the sound: {evidence.sound_problem}"
        return Decision(sync, "by timecode, unchecked", (note,))
    difference = abs(sound.offset - labels.offset)
    confirmed = difference <= labels.tolerance
    if spec.by == "auto" and not confirmed:
        return Decision(
            None,
            f"the offset is {labels.offset:+.3f} s by timecode and {sound.offset:+.3f} s by sound: "
            f"they differ by {1000 * difference:.0f} ms, more than the tolerance of timecode, "
            f"{1000 * labels.tolerance:.0f} ms; choose one with --by timecode or --by sound",
        )
    confidence = UNCHECKED_CONFIDENCE
    if confirmed:
        confidence += (1 - UNCHECKED_CONFIDENCE) * sound.confidence
    sync = VideoSync(labels.offset, 1e6 * sound.drift, confidence)
    return Decision(sync, "by timecode", _difference(labels.offset, evidence))


def _difference(offset: float, evidence: Evidence) -> tuple[str, ...]:
    """Return notes on the offsets by other sources."""
    sound, labels = evidence.trusted, evidence.timecode.offset
    others = {"sound": None if sound is None else sound.offset, "timecode": labels}
    return tuple(
        f"by {name} the offset is {other:+.4f} s, a difference of {1000 * (other - offset):+.1f} ms"
        for name, other in others.items()
        if other is not None and other != offset
    )


def _gather(take: Take, video: Video, progress: Progress) -> Evidence:
    with open_video(video.file, video.rate) as movie:
        silent_pictures = not isinstance(movie, VideoReader)
        labels = timecode_shift(
            take.timecode_start,
            take.rate,
            movie.timecode,
            movie.rate,
            first_picture=float(movie.times[0]),
        )
    if take.audio is None:
        reason = "the take has no sound recorded with the capture (ingest it with --audio)"
        return Evidence(None, reason, labels)
    if silent_pictures:
        return Evidence(None, f"{video.file}: an image sequence has no sound", labels)
    try:
        progress(0.0, f"reading the sound of {video.file.name}")
        camera = read_audio(video.file, rate=_SAMPLE_RATE)
        progress(0.25, f"reading {take.audio.name}")
        capture = read_audio(take.audio, rate=_SAMPLE_RATE)
    except InputError as error:
        return Evidence(None, str(error), labels)
    sound = align_sounds(
        camera,
        capture,
        rate=_SAMPLE_RATE,
        names=("camera's", "capture's"),
        progress=part(progress, 0.5, 1.0),
    )
    return Evidence(sound, "", labels)


def _page(take: Take, evidence: Evidence, decision: Decision) -> AlignmentPage:
    sync, sound, labels = decision.sync, evidence.sound, evidence.timecode
    facts = [f"{note[:1].upper()}{note[1:]}." for note in decision.notes]
    if sound is None and evidence.no_sound not in decision.source:
        facts.append(f"No sound compared: {evidence.no_sound}.")
    elif sound is not None:
        facts.append(
            f"Sound: best offset {sound.peak:.1f} deviations above chance, {sound.ratio:.2f} times "
            f"the second best; {sound.agreement:.0%} of windows agree, to "
            f"{1000 * sound.deviation:.3f} ms; confidence {sound.confidence:.2f}."
        )
    if labels.offset is None:
        facts.append(f"Timecode: not used, {labels.reason}.")
    marks = []
    if sync is not None:
        marks.append(ShiftMark(decision.source, sync.offset, chosen=True))
    if labels.offset is not None and (sync is None or sync.offset != labels.offset):
        marks.append(ShiftMark("timecode", labels.offset))
    if evidence.trusted is not None and (sync is None or sync.offset != evidence.trusted.offset):
        marks.append(ShiftMark("sound", evidence.trusted.offset))
    if sync is None:
        verdict = f"Not aligned: {decision.source}"
    else:
        verdict = (
            f"video starts {sync.offset:+.4f} s into the take, drift {sync.drift:+.1f} ppm, "
            f"{decision.source}, confidence {sync.confidence:.2f}"
        )
    file = "" if take.video is None else f", {take.video.file.name}"
    return AlignmentPage(
        title=f"{take.name}{file}: video against capture",
        verdict=verdict,
        accepted=sync is not None,
        facts=tuple(facts),
        sound=sound,
        marks=tuple(marks),
    )


def _figures(decision: Decision, evidence: Evidence) -> dict[str, object]:
    sync, sound = decision.sync, evidence.sound
    figures: dict[str, object] = {"source": decision.source}
    if sync is not None:
        figures |= {"offset": sync.offset, "drift_ppm": sync.drift, "confidence": sync.confidence}
    if evidence.timecode.offset is not None:
        figures["timecode_offset"] = evidence.timecode.offset
    if sound is not None:
        figures["sound"] = {
            "offset": sound.offset,
            "drift_ppm": 1e6 * sound.drift,
            "confidence": sound.confidence,
            "peak": sound.peak,
            "agreement": sound.agreement,
            "doubts": list(sound.warnings),
        }
    return figures
