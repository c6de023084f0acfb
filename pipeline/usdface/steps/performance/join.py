"""Join performances of consecutive frame ranges."""

import itertools
from dataclasses import replace
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path, head_path, weights_path
from usdface.core.text import first_few, pluralize
from usdface.runner.origin import provenance_of, spec_of
from usdface.runner.result import StepResult
from usdface.specs.performance import JoinSpec
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.steps.inputs.solve_verdict import judge_performance, with_verdict
from usdface.steps.performance.map import LARGEST_LAYER_BYTES
from usdface.usdio.performance.clips import ClipPart, write_clips
from usdface.usdio.performance.driving_layers import driving_layers, join_driving_layers
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import WeightsHeader, writing_weights
from usdface.usdio.performance.write import writing_top
from usdface.usdio.rig.reference import read_rig_of_stage

_FILES = ("take", "mapping", "rig", "source")
"""Options of `map` and `retarget` that name files of which all parts must have the same."""


def run(spec: JoinSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Merge the parts, or play them as value clips, by --clips and their size."""
    readers = sorted(map(PerformanceReader, spec.parts), key=lambda each: each.first_frame)
    headers = [reader.header for reader in readers]
    _check_parts(readers, headers)
    rig = read_rig_of_stage(readers[0].stage, readers[0].animation)
    whole = _with_source(replace(headers[0], last_frame=headers[-1].last_frame), headers)
    size = 4 * whole.frame_count * len(whole.shape_names)
    clips = spec.clips == "always" or (spec.clips == "auto" and size > LARGEST_LAYER_BYTES)
    target = weights_path(spec.out)

    def report(last: int) -> None:
        progress((last - whole.first_frame + 1) / whole.frame_count, f"joined to frame {last}")

    files = [each.path for each in readers]
    driving = {each(spec.out): driving_layers(readers, each) for each in (head_path, controls_path)}
    above = [layer for layer, of_parts in driving.items() if of_parts]
    if clips or above:
        _check_not_moved(readers)
    with writing_top(spec.out, whole, rig, above=above, provenance=provenance):
        if clips:
            parts = [_part(reader) for reader in readers]
            write_clips(target, whole, rig, parts, provenance=provenance)
        else:
            with writing_weights(target, whole, rig, provenance=provenance) as writer:
                for reader in readers:
                    writer.copy(
                        reader.animation, reader.first_frame, reader.last_frame, copied_to=report
                    )
        for layer, of_parts in driving.items():
            join_driving_layers(layer, of_parts, whole, provenance=provenance)
    notes = performance_notes(spec.out)
    notes += [
        f"{reader.path}: its edits of {first_few(sorted(reader.edits))} are not joined; edit the "
        "joined performance"
        for reader in readers
        if reader.edits
    ]
    first = _options(files[0])
    for each in files[1:]:
        other = _options(each)
        if differ := [name for name in first | other if first.get(name) != other.get(name)]:
            notes.append(f"{each}: made with another {' and '.join(differ)} than {files[0]}")
    how = "played as value clips" if clips else "merged"
    result = StepResult(
        (spec.out, target, *above),
        f"{pluralize(len(readers), 'part')} {how}: frames {whole.first_frame}-{whole.last_frame}",
        tuple(notes),
        {"frames": whole.frame_count, "parts": len(readers), "clips": clips},
    )
    return with_verdict(result, judge_performance(PerformanceReader(spec.out)))


def _with_source(whole: WeightsHeader, headers: list[WeightsHeader]) -> WeightsHeader:
    """Add the gaps of a retargeting's source, and its shapes that drive nothing."""
    gaps: list[tuple[int, int]] = []
    shares: dict[str, float] = {}
    for header in headers:
        for first, last in header.gaps:
            if gaps and gaps[-1][1] + 1 == first:  # the parts were cut within it
                first = gaps.pop()[0]
            gaps.append((first, last))
        known = header.unmatched_shares or (0.0,) * len(header.unmatched)
        for name, share in zip(header.unmatched, known, strict=True):
            shares[name] = shares.get(name, 0.0) + share * header.frame_count / whole.frame_count
    shares = dict(sorted(shares.items(), key=lambda each: -each[1]))  # the largest motion first
    stated = any(header.unmatched_shares for header in headers)
    return replace(
        whole,
        gaps=tuple(gaps),
        unmatched=tuple(shares),
        unmatched_shares=tuple(shares.values()) if stated else (),
    )


def _check_parts(readers: list[PerformanceReader], headers: list[WeightsHeader]) -> None:
    """Refuse parts that do not fit the first, overlap, or leave a gap, naming all of them."""
    faults, inputs = [], _inputs(readers[0].path)
    for reader, header in zip(readers[1:], headers[1:], strict=True):
        for what, found, wanted in (
            ("shapes", header.shape_names, headers[0].shape_names),
            ("rate", header.rate, headers[0].rate),
            ("prim", header.rig_path, headers[0].rig_path),
            ("regions", header.regions, headers[0].regions),
            ("rig", reader.rig(), readers[0].rig()),
            *((name, made, inputs.get(name, made)) for name, made in _inputs(reader.path).items()),
        ):
            if found != wanted:
                faults.append(f"{reader.path}: has another {what} than {readers[0].path}")
    for before, after in itertools.pairwise(readers):
        gap = after.first_frame - before.last_frame - 1
        if gap > 0:
            faults.append(
                f"frames {before.last_frame + 1}-{after.first_frame - 1} are in no part: between "
                f"{before.path} and {after.path}"
            )
        elif gap < 0:
            faults.append(
                f"frames {after.first_frame}-{min(before.last_frame, after.last_frame)} are in two "
                f"parts: {before.path} and {after.path}"
            )
    if faults:
        raise InputError("; ".join(faults) + "; map those parts again")


def _inputs(part: Path) -> dict[str, str]:
    """Return the hashes of the files that a part was made from."""
    made = provenance_of(part) or Provenance()
    named = spec_of(made)
    return {
        f"{name} (file or contents)": made.inputs[named[name]]
        for name in _FILES
        if isinstance(named.get(name), str) and named[name] in made.inputs
    }


def _options(part: Path) -> dict[str, object]:
    """Return the options that a part was made with, apart from its frames and files."""
    apart = (*_FILES, "frames", "out", "chunk", "parts", "clips")
    return {key: value for key, value in spec_of(provenance_of(part)).items() if key not in apart}


def _check_not_moved(readers: list[PerformanceReader]) -> None:
    """Refuse parts with layer offsets, as their layers' samples stay at the mapped frames."""
    moved = next((reader for reader in readers if reader.time_shift), None)
    if moved is not None:
        raise InputError(
            f"{moved.path}: a layer above moves it {moved.time_shift}, which value clips and "
            "layers that drive joints do not support; join without that, and move the joined "
            "performance"
        )


def _part(reader: PerformanceReader) -> ClipPart:
    file = weights_path(Path(reader.path))
    if not file.is_file():
        raise InputError(
            f"{file}: no such file; value clips play the parts' weights from where `map` wrote "
            "them: put it back, or map the part again"
        )
    return ClipPart(file, reader.first_frame, reader.last_frame, str(reader.animation.GetPath()))
