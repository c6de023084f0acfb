"""Combine performances of one character in an asset with a variant per take."""

from collections.abc import Sequence

from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import first_few, pluralize, repeated
from usdface.runner.result import StepResult
from usdface.specs.edits import CombineSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import VARIANT_SET
from usdface.usdio.performance.write import write_takes


def run(spec: CombineSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Check that the performances are of one rig at one rate, and write the asset over them."""
    names = _names(spec)
    readers = [PerformanceReader(path) for path in spec.performances]
    _check_alike(spec, readers)
    progress(0.5, f"writing {spec.out.name}")
    write_takes(spec.out, dict(zip(names, readers, strict=True)), provenance=provenance)
    edited = [name for name, each in zip(names, readers, strict=True) if each.edits]
    notes: tuple[str, ...] = ()
    if edited:
        notes = (f"edits of {first_few(edited)} show only in usdface until they are baked",)
    return StepResult(
        (spec.out,),
        f"{pluralize(len(names), 'take')} of one character, variants `{VARIANT_SET}`: "
        f"{first_few(names)}; {names[0]} is shown",
        notes,
        {
            "takes": {
                name: [each.first_frame, each.last_frame]
                for name, each in zip(names, readers, strict=True)
            },
            "shown": names[0],
        },
    )


def _names(spec: CombineSpec) -> list[str]:
    """Return a variant name per performance; by default the file's name without common endings."""
    given = list(spec.takes)
    if given and len(given) != len(spec.performances):
        raise InputError(
            f"--takes names {len(given)} takes for {len(spec.performances)} performances; give "
            "one name each"
        )
    stems = [path.name.split(".") for path in spec.performances]
    common = 0
    while min(map(len, stems)) - common > 1 and len({s[-1 - common] for s in stems}) == 1:
        common += 1
    names = given or [".".join(stem[: len(stem) - common]) for stem in stems]
    names = ["".join(each if _may_name_variant(each) else "_" for each in name) for name in names]
    if twice := repeated(names):
        raise InputError(f"two performances would be named {min(twice)}; name them with --takes")
    return names


def _may_name_variant(letter: str) -> bool:
    """Whether USD accepts a character in the name of a variant: letters of all scripts."""
    return letter in "|-" or f"a{letter}".isidentifier()


def _check_alike(spec: CombineSpec, readers: Sequence[PerformanceReader]) -> None:
    first, path = readers[0], spec.performances[0]
    rig, prim = first.rig()
    for reader, other in zip(readers[1:], spec.performances[1:], strict=True):
        file, place = reader.rig()
        if (file.resolve(), place) != (rig.resolve(), prim):
            raise InputError(
                f"{other}: is of {file} <{place}>, and {path} of {rig} <{prim}>; combine takes of "
                "one character"
            )
        if reader.rate != first.rate:
            raise InputError(
                f"{other}: runs at {float(reader.rate):g} frames per second, and {path} at "
                f"{float(first.rate):g}; combine takes of the same rate"
            )
        if reader.header.rig_path != first.header.rig_path:
            raise InputError(
                f"{other}: has the rig at <{reader.header.rig_path}>, and {path} at "
                f"<{first.header.rig_path}>; map or retarget it again with "
                f"--prim {first.header.rig_path}"
            )
