"""Provenance of files: made from a spec, read back, and used to find a file's inputs."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from usdface.core.errors import InputError
from usdface.core.provenance import Provenance, canonical_json, hash_files, relative_name
from usdface.core.sidecars import corrected_path, is_usd_name
from usdface.core.text import json_object, pluralize, read_text
from usdface.specs.base import Spec
from usdface.specs.paths import IMAGE_SUFFIXES, Reads, Writes
from usdface.specs.review import MOVIE_SUFFIXES, PAGE_SUFFIXES
from usdface.usdio.layers import is_layer_name, read_provenance
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.referenced_files import dependencies, referenced_files
from usdface.usdio.take.read import TakeReader, is_take

LARGEST_FIGURES_BYTES = 64 << 20

REFUSED_SUFFIX = " refused"
"""Suffix of a step's name in outputs written on failure, which are never up to date."""


def provenance_of(path: Path) -> Provenance | None:
    """Return the provenance stored in a file; None if there is none or it cannot be read."""
    try:
        if is_usd_name(path):
            return read_provenance(path)
        if path.suffix.lower() in IMAGE_SUFFIXES:
            from usdface.media.picture.image import read_image_metadata  # slow to import

            return _from_metadata(read_image_metadata(path))
        if path.suffix.lower() in MOVIE_SUFFIXES:
            from usdface.media.film.movie import read_movie_comment

            return _from_metadata(json_object(read_movie_comment(path)))
        if path.suffix.lower() in PAGE_SUFFIXES:
            from usdface.media.page.report_page import read_page_origin

            return _from_metadata(json_object(read_page_origin(path)))
        if path.suffix.lower() == ".json":
            made = json_object(read_text(path, LARGEST_FIGURES_BYTES)).get("provenance")
            return _from_metadata(made) if isinstance(made, dict) else None
        if path.suffix.lower() == ".textgrid":
            from usdface.speech.track_files import read_origin

            return _from_metadata(read_origin(path) or {})
    except InputError:
        return None
    return None


def make_provenance(spec: Spec) -> Provenance:
    """Hash a spec's inputs; paths are stored relative to the output, so that folders can move."""
    anchor = spec.outputs()[0].resolve().parent if spec.outputs() else Path.cwd()
    read = {**traced_files(spec), **spec.reads()}
    inputs = {relative_name(path, anchor): hash_input(path, how) for path, how in read.items()}
    data = spec.model_dump(mode="json", exclude_defaults=True)
    for kind in (Reads, Writes):
        for name in type(spec).fields_marked(kind):
            value = getattr(spec, name)
            if isinstance(value, Path):
                data[name] = relative_name(value, anchor)
            elif value is not None:
                data[name] = [relative_name(each, anchor) for each in value]
    return Provenance(step=spec.step, spec=canonical_json(data), inputs=inputs)


_TRACED = {"take": Reads(assets=True), "source": Reads(assets=True)} | dict.fromkeys(
    ("mapping", "references", "placement", "parts"), Reads()
)
"""Fields of a stored spec by which steps find further inputs, and how these are read."""


def traced_files(spec: Spec) -> dict[Path, Reads]:
    """Return the files that a step reads although the spec does not give them.

    The provenance of a performance names take and mapping, that of a mapping the references. A
    binding is made again from its corrections.
    """
    given = {name for name in _TRACED if getattr(spec, name, None)}
    found: dict[Path, Reads] = {}
    traced = [path for name in spec.traces for path in spec.paths_of(name)]
    waiting = [file for path in traced if path.is_file() for file in made_files(path)]
    seen: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file.resolve() in seen or not file.is_file():
            continue
        seen.add(file.resolve())
        named = spec_of(provenance_of(file))
        for name in _TRACED:  # in fixed order: provenance is part of the output's bytes
            if name in given or name not in named:
                continue
            for path in _paths_in(named[name], file.parent):
                if path.is_file():
                    found[path] = _TRACED[name]
                    waiting += [path] if name in ("mapping", "parts", "source") else []
    binding = spec.written_binding()
    from usdface.usdio.surface.binding import has_corrections  # SciPy is slow to import

    if binding is not None and has_corrections(corrections := corrected_path(binding)):
        found[corrections] = Reads(alone=True)
    return found


def made_files(performance: Path) -> list[Path]:
    """Return a performance and, if it does not name its inputs, as a shot, the files below it."""
    if _TRACED.keys() & spec_of(provenance_of(performance)).keys() or not is_usd_name(performance):
        return [performance]
    try:
        files = PerformanceReader(performance).files
    except InputError:  # damaged, and perhaps about to be replaced
        return [performance]
    return [performance, *(each for each in files if each.resolve() != performance.resolve())]


def _paths_in(value: object, folder: Path) -> list[Path]:
    """Return the files of a stored field that may hold one path, several or none."""
    several = value if isinstance(value, list) else [value]
    return [folder / each for each in several if isinstance(each, str) and each]


def _from_metadata(metadata: dict[str, object]) -> Provenance | None:
    inputs = metadata.get("inputs")
    if "usdface" not in metadata or not isinstance(inputs, dict):
        return None
    return Provenance(
        step=str(metadata.get("step", "")),
        spec=str(metadata.get("spec", "")),
        inputs={str(key): str(value) for key, value in inputs.items()},
        version=str(metadata["usdface"]),
    )


def hash_input(path: Path, how: Reads = Reads()) -> str:  # noqa: B008  # it is frozen
    """Return the hash of an input for provenance, over all its files."""
    return hash_files(input_files(path, how))


def changed_inputs(file: Path) -> list[Path]:
    """Return the inputs of a file, by its provenance, that exist with other contents."""
    made, anchor = provenance_of(file), file.resolve().parent
    named = {anchor / name: known for name, known in (made.inputs.items() if made else ())}
    return [path for path, known in named.items() if path.is_file() and not _is_same(path, known)]


def _is_same(path: Path, known: str) -> bool:
    try:
        ways = (Reads(), Reads(assets=True), Reads(sequence=True))
        return any(known == hash_input(path, how) for how in ways)
    except InputError:  # unreadable, or outside USDFACE_ROOT
        return True


def input_files(path: Path, how: Reads) -> list[Path]:
    """Return an input; of a layer, those that it composes; of a picture, those of its sequence.

    Textures and movies of a layer as well, if the step reads them.
    """
    if how.sequence and path.suffix.lower() in (*IMAGE_SUFFIXES, ".dpx"):
        from usdface.media.film.timed_frames import ImageSequence  # slow to import

        return ImageSequence(path, Fraction(1)).files
    if how.alone or not is_layer_name(path):
        return [path]
    return referenced_files(path) if how.assets else dependencies(path)


def spec_of(provenance: Provenance | None) -> dict[str, Any]:
    """Return the spec stored in provenance; empty if there is none."""
    return {} if provenance is None else json_object(provenance.spec)


def path_made_from(file: Path, field: str) -> Path | None:
    """Return the file that a field of a file's stored spec names; None if there is no such file."""
    paths = _paths_in(spec_of(provenance_of(file)).get(field), file.parent)
    return paths[0] if len(paths) == 1 and paths[0].is_file() else None


def find_made_by(performance: Path, step: str, through: Mapping[str, str]) -> Path | None:
    """Return the file of a performance that a step wrote; None if there is none.

    In a shot it lies below the performance. `through`: steps that copy a performance, and the field
    of their spec that names it; of several files in the field, the first is followed.
    """
    waiting, seen = made_files(performance), set[Path]()
    while waiting:
        file = waiting.pop(0)
        made = provenance_of(file) if file.is_file() and file.resolve() not in seen else None
        seen.add(file.resolve())  # relative names add up: a/../b/../a is a
        if made is None:
            continue
        if made.step == step:
            return file
        named = spec_of(made).get(through.get(made.step, ""))
        waiting += _paths_in(named, file.resolve().parent)[:1]
    return None


def find_take(performance: Path, given: Path | None) -> Path:
    """Return the given take if a performance was mapped from it, by default its stored take."""
    stored = take_of_performance(performance)
    if given is None:
        if stored is None:
            raise InputError(f"{performance}: does not name its take; give it by --take")
        if not stored.is_file():
            raise InputError(
                f"{performance}: its take, {stored}, is gone; give its new path by --take"
            )
        return stored
    if stored is None or _was_read(stored, given, performance):
        return given
    raise InputError(
        f"{given}: not the take of {performance.name}, which was mapped from {stored}; leave out "
        "--take, or map this take first"
    )


def _was_read(stored: Path, given: Path, performance: Path) -> bool:
    """Whether the given take is the stored one of a performance, by name or by content."""
    made = provenance_of(performance)
    return stored.name == given.name or made is None or hash_input(given) in made.inputs.values()


def check_same_take(performance: Path, take: Path | None, others: Sequence[Path]) -> None:
    """Refuse other performances that are of another take than the first, by default its stored one.

    Takes are compared by their stored names, or as by `find_take` if a file is missing or not USD.
    A performance that names no take only needs the same rate.
    """
    rate, first = PerformanceReader(performance).rate, take or take_of_performance(performance)
    for other in others:
        second, other_rate = take_of_performance(other), PerformanceReader(other).rate
        where = f"{other}: is of another take than {performance.name}"
        if other_rate != rate:
            raise InputError(
                f"{where}: it has {float(other_rate):g} frames per second, not {float(rate):g}; "
                "leave it out of --also"
            )
        if first is not None and second is not None and not _one_take(first, second, other):
            raise InputError(
                f"{where}: of {second}, not of {first}; leave it out of --also, which takes "
                "performances of one take"
            )


def _one_take(first: Path, second: Path, other: Path) -> bool:
    if _is_take_file(first) and _is_take_file(second):
        return TakeReader(first).name == TakeReader(second).name
    return first.name == second.name or (first.is_file() and _was_read(second, first, other))


def take_name(performance: Path) -> str:
    """Return the stored name of a performance's take; empty if it has none, or its file is gone."""
    take = existing_take(performance)
    return "" if take is None else TakeReader(take).name


def existing_take(performance: Path) -> Path | None:
    """Return the take of a performance, by its provenance, if it exists, else None."""
    take = take_of_performance(performance)
    return take if take is not None and _is_take_file(take) else None


def _is_take_file(path: Path) -> bool:
    return path.is_file() and is_usd_name(path) and is_take(path)


def pair_with_files(
    performances: Sequence[Path], given: Sequence[Path], what: str
) -> list[tuple[Path, Path | None]]:
    """Return each performance with its file, or the common one, of option `what`, else None."""
    count, files = len(performances), tuple(given) or (None,)
    if len(files) not in (1, count):
        raise InputError(
            f"--{what} names {pluralize(len(files), what)} for {count} performances; give one "
            "each, or one for all"
        )
    return list(zip(performances, files * (count // len(files)), strict=True))


def take_of_performance(performance: Path) -> Path | None:
    """Return the take in a performance's provenance, of the source if retargeted; None if none.

    A layer above a performance has the take of that performance, unless it moves its frames.
    """
    above, *below = made_files(performance)
    if below and not PerformanceReader(above).time_shift:
        return next((take for each in below if (take := take_of_performance(each))), None)
    file, seen = performance, set[Path]()
    while file.resolve() not in seen:
        seen.add(file.resolve())
        spec = spec_of(provenance_of(file))
        mapped = "take" in spec and "source" not in spec  # the take of a table is no file
        parts = spec.get("parts") or [None]  # the parts of a joined performance share a take
        named = spec.get("take") if mapped else spec.get("source", parts[0])
        if not isinstance(named, str) or not named:
            return None
        file = file.parent / named
        if mapped or not file.is_file() or not is_usd_name(file) or is_take(file):
            return file
    return None
