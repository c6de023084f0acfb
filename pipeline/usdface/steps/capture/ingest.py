"""Convert the capture files of a take to USD."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.capture.channel_take import with_stated_rate
from usdface.capture.marker_labels import match_labels, resolve_labels
from usdface.capture.marker_take import Capture, CaptureHeader, CaptureOptions, build_marker_take
from usdface.capture.sniff import read_capture
from usdface.core.assets import Take, Video
from usdface.core.errors import InputError, as_input_error
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.rates import exact_rate, frames_of, valid_timecode
from usdface.core.sidecars import is_usd_name, samples_path
from usdface.core.text import pluralize
from usdface.media.film.video import open_video
from usdface.model.placement.plausibility import check_findings, judge_markers
from usdface.runner.result import StepResult
from usdface.specs.capture import IngestSpec
from usdface.specs.paths import frame_range
from usdface.steps.capture.merge_captures import (
    cut_frames,
    exchange_sides,
    extract_sound,
    join_captures,
    padding_notes,
)
from usdface.steps.inputs.cleaned_takes import check_neutral_frame
from usdface.usdio.take.foreign import read_foreign_take
from usdface.usdio.take.read import is_take, read_first_frame, read_take
from usdface.usdio.take.write import write_take

log = logging.getLogger(__name__)


def run(spec: IngestSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Read captures of one take and write it as USD."""
    if spec.only is not None:
        raise InputError("--only chooses among the captures of a folder; leave it out for files")
    captures = []
    for index, source in enumerate(spec.sources):
        progress(0.6 * index / len(spec.sources), f"reading {source.name}")
        captures.append(_read_source(source, spec))
    takes = _labelled([capture.take for capture in captures], spec)
    take, join_notes = join_captures(takes, spec.sources)
    if spec.mirrored in ("labels", "axes"):
        take = exchange_sides(take, spec.mirrored, where=_names(spec))
    warnings = _plausibility(spec, take, captures)
    timecode, timecode_notes = valid_timecode(take.timecode_start, take.rate)
    timecode_notes = tuple(f"{note}; name another with --timecode" for note in timecode_notes)
    take = replace(
        take,
        name=spec.take or take.name,
        performer=spec.performer or take.performer,
        session=spec.session or take.session,
        emotion=spec.emotion or take.emotion,
        timecode_start=timecode,
        video=take.video if spec.video is None else _open_video(spec.video, spec),
        warnings=warnings,
    )
    first, count, padding = take.first_frame, take.frame_count, padding_notes(take)
    limits = frame_range(spec.frames)
    if limits is not None:
        take, padding = _cut(spec, take, limits)
    skipped = (take.first_frame - first, first + count - take.first_frame - take.frame_count)
    made, sound_notes = _capture_sound(spec, skipped)
    take = replace(take, audio=spec.audio or take.audio or next(iter(made), None))
    progress(0.7, f"writing {spec.out.name}")
    write_take(spec.out, take, provenance=provenance)
    notes = (*(note for capture in captures for note in capture.notes), *join_notes)
    notes += (*timecode_notes, *padding, *(warnings or ()), *_unused_notes(spec, take, captures))
    log.info("%s: %d frames", spec.out, take.frame_count)
    return _report(spec, take, (*notes, *sound_notes), made)


def _labelled(takes: list[Take], spec: IngestSpec) -> list[Take]:
    """Set --timecode on the capture whose frames the take will have."""
    if not spec.timecode:
        return takes
    first = next((at for at, take in enumerate(takes) if take.markers is not None), 0)
    with as_input_error("--timecode", of=InputError):
        frames_of(spec.timecode, takes[first].rate)
    named = replace(takes[first], timecode_start=spec.timecode)
    return [named if at == first else take for at, take in enumerate(takes)]


def _read_source(source: Path, spec: IngestSpec) -> Capture:
    if is_usd_name(source):
        capture = _read_usd(source, spec)
    else:
        capture = read_capture(
            source,
            format=spec.format,
            units=spec.units,
            scale=spec.scale,
            up=spec.up,
            rate=spec.rate,
            rigid=spec.rigid,
            neutral=spec.neutral,
            weight_unit=spec.weight_unit,
            shapes=spec.shapes,
            take=spec.take,
        )
    timed = capture.take.markers is None and capture.format != "weights"
    if spec.rate is not None and len(spec.sources) == 1 and timed:
        return with_stated_rate(capture, spec.rate, where=source)
    return capture


def _unused_notes(spec: IngestSpec, take: Take, captures: list[Capture]) -> list[str]:
    """Return a note on each option without effect on these captures."""
    unused: list[tuple[str, tuple[str, ...]]] = []
    if take.markers is None:
        unused += [("marker", ("units", "scale", "up", "mirrored", "partial", "rigid", "neutral"))]
    if all(each.format != "weights" for each in captures):
        unused += [("table of weights", ("weight_unit",))]
    if all(each.suffix.lower() != ".npy" for each in spec.sources):
        unused += [(".npy table", ("shapes",))]
    return [
        f"--{name.replace('_', '-')} has no effect: there is no {missing} in {_names(spec)}"
        for missing, names in unused
        for name in names
        if spec.is_given(name)
    ]


def _names(spec: IngestSpec) -> str:
    return ", ".join(map(str, spec.sources))


def _plausibility(spec: IngestSpec, take: Take, captures: list[Capture]) -> tuple[str, ...] | None:
    """Return warnings about the markers; refuse impossible ones unless an option states them."""
    if take.markers is None:
        return None
    capture = next(each for each in captures if each.take.markers is not None)
    stated = {
        "size": spec.units is not None or spec.scale is not None,
        "up": spec.up is not None or capture.format == "usd",
        "sides": spec.mirrored is not None,
        "part": spec.partial,
        "rate": spec.rate is not None,
    }
    findings = judge_markers(take.markers, float(take.rate), axes=capture.axes)
    return check_findings(
        findings, stated=[aspect for aspect, given in stated.items() if given], where=_names(spec)
    )


def _cut(spec: IngestSpec, take: Take, limits: tuple[int, int]) -> tuple[Take, list[str]]:
    """Keep the frames of --frames; return a note if the neutral frame changes."""
    if take.audio is not None:
        raise InputError(
            f"{_names(spec)}: the take has sound, {take.audio.name}, which would start too early; "
            "leave out --frames"
        )
    if spec.neutral is not None and not limits[0] <= spec.neutral <= limits[1]:
        raise InputError(
            f"{_names(spec)}: neutral frame {spec.neutral} is not among --frames "
            f"{limits[0]}-{limits[1]}; name one of them with --neutral"
        )
    cut = cut_frames(take, limits, where=_names(spec))
    before, after = take.markers, cut.markers
    if before is None or after is None or before.neutral_frame == after.neutral_frame:
        return cut, []
    return cut, [f"the neutral frame was cut off; frame {after.neutral_frame} is used instead"]


def _read_usd(source: Path, spec: IngestSpec) -> Capture:
    if spec.units is not None or spec.up is not None:
        raise InputError(
            f"{source}: a USD file states its units and up axis; author metersPerUnit and upAxis "
            "in it instead of using --units and --up (--scale works)"
        )
    if is_take(source):
        return Capture(_with_options(read_take(source), spec, source), "usd")
    found = read_foreign_take(source, prim=spec.prim)
    if not found.names:
        take = Take(source.stem, found.rate, found.first_frame, source=found.source)
        return Capture(take, "usd", ("no markers, only blendshape weights",))
    labels = resolve_labels(found.names, where=f"{source} {found.kind}")
    notes = [f"markers were found as {found.kind}", *labels.notes]
    columns = list(labels.columns)
    capture = build_marker_take(
        CaptureHeader(source, "usd", found.rate, found.first_frame, notes=notes),
        labels.names,
        found.positions[:, columns] * np.float32(spec.scale or 1.0),
        found.visible[:, columns],
        CaptureOptions(rate=spec.rate, rigid=spec.rigid, neutral=spec.neutral),
    )
    return replace(capture, take=replace(capture.take, source=found.source))


def _with_options(take: Take, spec: IngestSpec, source: Path) -> Take:
    """Return a USD take with scale, rate, rigid markers and neutral frame of the options."""
    markers = take.markers
    if markers is None:
        return take
    if spec.scale is not None:
        markers = replace(markers, positions=markers.positions * np.float32(spec.scale))
        if take.head_motion is not None:
            resized = np.diag([spec.scale, spec.scale, spec.scale, 1.0])
            motion = resized @ take.head_motion @ np.linalg.inv(resized)
            take = replace(take, head_motion=motion)
    if spec.rate is not None:
        rate = exact_rate(spec.rate, where="--rate")
        clip = None if take.source is None else replace(take.source, rate=rate)
        take = replace(take, rate=rate, source=clip)
    if spec.rigid:
        named = match_labels(spec.rigid, markers.names, where=str(source))
        markers = replace(markers, rigid=named)
    if spec.neutral is not None:
        check_neutral_frame(source, spec.neutral, take, "name another with --neutral")
        markers = replace(markers, neutral_frame=spec.neutral)
    return replace(take, markers=markers)


def _capture_sound(
    spec: IngestSpec, skipped: tuple[int, int]
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Extract the sound of the captures, without skipped frames; return file and note, if any."""
    if spec.audio is not None:
        return (), ()
    out = spec.out.with_name(f"{spec.out.stem}.sound.wav")
    ours = out.exists() and spec.out.exists() and _is_sound_of(spec.out, out)
    note = extract_sound(spec.sources, out, channel=spec.audio_channel, ours=ours, skipped=skipped)
    return ((), ()) if note is None else ((out,), (note,))


def _is_sound_of(path: Path, sound: Path) -> bool:
    try:
        take = read_first_frame(path)
    except InputError:  # a damaged take, which is replaced
        return False
    return take.audio is not None and take.audio.resolve() == sound.resolve()


def _open_video(file: Path, spec: IngestSpec) -> Video:
    rate = None if spec.video_rate is None else exact_rate(spec.video_rate, where=str(file))
    with open_video(file, rate) as video:
        return Video(file=file, rate=video.rate, offset=spec.video_offset)


def _report(
    spec: IngestSpec, take: Take, notes: tuple[str, ...], made: tuple[Path, ...]
) -> StepResult:
    rate = float(take.rate)
    figures: dict[str, object] = {
        "frames": take.frame_count,
        "rate": rate,
        "first_frame": take.first_frame,
    }
    parts = [
        f"{pluralize(take.frame_count, 'frame')} at {rate:g} per second "
        f"({take.frame_count / rate:.1f} s)"
    ]
    if take.markers is not None:
        gaps = float(1 - take.markers.visible.mean())
        figures |= {
            "markers": len(take.markers.names),
            "rigid": list(take.markers.rigid),
            "neutral_frame": take.markers.neutral_frame,
            "gap_share": gaps,
        }
        parts.append(f"{pluralize(len(take.markers.names), 'marker')}, {100 * gaps:.2f} % gaps")
    if take.source is not None:
        figures["channels"] = len(take.source.names)
        parts.append(pluralize(len(take.source.names), "weight"))
    outputs = tuple(dict.fromkeys((spec.out, samples_path(spec.out), *made)))
    if take.events:
        figures["events"] = [[event.label, event.frame] for event in take.events]
        parts.append(pluralize(len(take.events), "event"))
    return StepResult(outputs, f"{take.name}: {', '.join(parts)}", notes, figures)
