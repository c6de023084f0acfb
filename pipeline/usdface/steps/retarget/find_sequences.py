"""Find the frames of a source performance that match emotional sequences."""

from fnmatch import fnmatchcase
from pathlib import Path

from usdface.core.arrays import FloatArray
from usdface.core.controls import EmotionalSequence, SequenceMatch
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.model.retarget.head_pose import is_angle
from usdface.numerics.motion.sequence_search import (
    PAPER_DELTA,
    Matches,
    best_match,
    find_published,
    find_sequence,
)
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import FindSequencesSpec
from usdface.steps.inputs.source_motion import SourceMotion, read_source_motion, source_columns
from usdface.steps.retarget.make_sequence import read_sequence_at
from usdface.usdio.retarget.sequences import write_matches

_RatedMatch = tuple[float, SequenceMatch]
"""A match after its distance divided by the threshold, which is comparable between sequences."""


def run(spec: FindSequencesSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Search for every sequence; of overlapping matches, keep the nearest."""
    motion = read_source_motion(spec.source, frame_range(spec.frames))
    sequences, notes = _read_sequences(spec, motion)
    found: list[_RatedMatch] = []
    for number, (path, sequence) in enumerate(sequences, start=1):
        matches, match_notes = _find(spec, path, sequence, motion)
        found += matches
        notes += match_notes
        progress(number / len(sequences), f"searched for {sequence.label}")
    kept: list[SequenceMatch] = []
    for _, match in sorted(found, key=lambda rated: rated[0]):
        first, last = match.first_frame, match.last_frame
        if any(first <= other.last_frame and other.first_frame <= last for other in kept):
            notes.append(
                f"frames {first}-{last} also match {match.label} ({match.sequence.name}), at a "
                "larger distance than the sequence kept there"
            )
        else:
            kept.append(match)
    kept.sort(key=lambda each: each.first_frame)
    write_matches(spec.out, tuple(kept), rate=motion.rate, provenance=provenance)
    return StepResult(
        (spec.out,),
        f"{pluralize(len(sequences), 'sequence')} at {pluralize(len(kept), 'place')} in "
        f"{len(motion.weights)} frames",
        tuple(dict.fromkeys(notes)),
        {
            "matches": [
                {
                    "sequence": str(each.sequence),
                    "label": each.label,
                    "frames": [each.first_frame, each.last_frame],
                    "distance": each.distance,
                }
                for each in kept
            ]
        },
        table=tuple(
            f"{each.first_frame}-{each.last_frame} {each.label}: {each.distance:.3f} off in the "
            "mean weight"
            for each in kept
        ),
    )


def _read_sequences(
    spec: FindSequencesSpec, motion: SourceMotion
) -> tuple[list[tuple[Path, EmotionalSequence]], list[str]]:
    """Read the sequences at the rate of the motion; return them with notes on other rates."""
    read = {path: read_sequence_at(path, motion.rate) for path in spec.sequence}
    sequences = [(path, sequence) for path, (sequence, _) in read.items()]
    label = spec.label or (motion.emotion if spec.by == "label" else None)
    if spec.by == "label" and not label:
        raise InputError(f"{spec.source}: states no emotion, so --by label needs --label NAME")
    if label:
        wanted = [each for each in sequences if each[1].label.lower() == label.lower()]
        if not wanted:
            known = ", ".join(sorted({each.label for _, each in sequences}))
            raise InputError(f"no sequence is labelled {label!r}; there are {known}")
        sequences = wanted
    count, fitting = len(motion.weights), []
    notes: list[str] = []
    for path, sequence in sequences:
        if len(sequence.source) <= count:
            fitting.append((path, sequence))
            notes += filter(None, [read[path][1]])
        else:
            notes.append(
                f"{path}: the sequence {sequence.label!r} is {len(sequence.source)} frames long, "
                f"and {spec.source} has {count}; search a longer take or shorten the sequence"
            )
    if not fitting:
        raise InputError(notes[0])
    return fitting, notes


def _find(
    spec: FindSequencesSpec, path: Path, sequence: EmotionalSequence, motion: SourceMotion
) -> tuple[list[_RatedMatch], list[str]]:
    weights, notes = source_columns(spec.source, motion, sequence.source_shapes)
    columns = _columns(spec, path, sequence, motion.driven)
    taken, wanted = weights[:, columns], sequence.source[:, columns]
    try:
        matches = _search(spec, taken, wanted)
    except ValueError as error:
        raise InputError(f"{path}: {error}; compare other --shapes or cut it again") from error
    length = len(wanted)
    found = []
    for start, distance in zip(matches.starts.tolist(), matches.distances.tolist(), strict=True):
        first = motion.first_frame + start
        match = SequenceMatch(path, sequence.label, first, first + length - 1, distance)
        found.append((distance / max(matches.threshold, 1e-12), match))
    if not found:
        nearest = best_match(taken, wanted)
        first = motion.first_frame + int(nearest.starts[0])
        notes = (
            *notes,
            f"{path.name}: no frames are within {matches.threshold:.3f} of it; the nearest, "
            f"{first}-{first + length - 1}, are {nearest.distances[0]:.3f} off: if they show "
            f"{sequence.label}, raise --threshold (with --by threshold), or compare its --shapes",
        )
    return found, list(notes)


def _search(spec: FindSequencesSpec, motion: FloatArray, sequence: FloatArray) -> Matches:
    if spec.by == "label":
        return best_match(motion, sequence)
    if spec.by == "published":
        return find_published(motion, sequence, delta=spec.threshold or PAPER_DELTA)
    return find_sequence(motion, sequence, threshold=spec.threshold)


def _columns(
    spec: FindSequencesSpec, path: Path, sequence: EmotionalSequence, driven: frozenset[str]
) -> list[int]:
    """Return the columns to compare: driven shapes would count twice, angles have another unit."""
    patterns = [pattern.lower() for pattern in spec.shapes or ("*",)]
    chosen = [
        index
        for index, name in enumerate(sequence.source_shapes)
        if name not in driven
        and not is_angle(name)
        and any(fnmatchcase(name.lower(), pattern) for pattern in patterns)
    ]
    if not chosen:
        raise InputError(
            f"{path}: none of its {len(sequence.source_shapes)} shapes that no others drive "
            f"matches {', '.join(spec.shapes) or '*'}; correct --shapes"
        )
    return chosen
