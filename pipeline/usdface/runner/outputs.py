"""Before a step runs: are its inputs there, and may its outputs be written."""

import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.provenance import Provenance, canonical_json, hash_files
from usdface.core.replacing import check_unprotected
from usdface.core.sidecars import LAYER_SUFFIXES, proposed_path, take_samples_path, weights_path
from usdface.runner.sandbox import check_confined_inputs
from usdface.specs.base import Spec
from usdface.specs.paths import IMAGE_SUFFIXES, Reads, Writes, confinement_root
from usdface.specs.review import MOVIE_SUFFIXES, PAGE_SUFFIXES
from usdface.usdio.layers import dependencies, is_layer_name, read_provenance

LARGEST_FIGURES_BYTES = 64 << 20

_ALIKE = (
    {"map", "join", "retarget"},
    {"select", "references-from-edits", "references-import"},
    {"pairs-propose", "pairs-import"},
    {"edit", "edits-import"},
    {"align", "align refused"},
    {"movie", "movie-join"},
)
"""Steps that make the same kind of file; any other makes one of its own."""


BESIDE: dict[str, Callable[[Path], Path]] = {
    "ingest": take_samples_path,
    "clean": take_samples_path,
    "map": weights_path,
    "join": weights_path,
    "retarget": weights_path,
    "warp": weights_path,
    "select": proposed_path,
    "references-from-edits": proposed_path,
    "pairs-propose": proposed_path,
    "pairs-import": proposed_path,
    "bind": proposed_path,
}
"""Where a step writes what lies beneath the layer to open."""


def check_inputs(spec: Spec) -> None:
    """Raise InputError naming every file that a spec reads and that is not there."""
    check_may_be_read(spec)
    missing = [path for path in spec.paths(Reads) if not path.exists()]
    if missing:
        names = ", ".join(map(str, missing))
        raise InputError(f"{spec.step}: {names}: no such file; check the path")


def check_may_be_read(spec: Spec) -> None:
    """Raise InputError if a spec leaves the folder of ``USDFACE_ROOT``, or reads what is no file.

    Before anything is opened, to hash it or to use it.
    """
    root = confinement_root()
    if root is not None:
        check_confined_inputs(spec, root)
    # A pipe or a device may never end, or never begin.
    paths = [path for path in spec.paths(Reads) if path.exists()]
    odd = [path for path in paths if not (path.is_file() or path.is_dir())]
    if odd:
        names = ", ".join(map(str, odd))
        raise InputError(f"{spec.step}: {names}: a pipe or a device, not a file; copy it to one")


def check_outputs(spec: Spec, *, overwrite: bool) -> None:
    """Raise InputError if an output cannot be written, or would replace what should be kept.

    A file is replaced without asking only if this package wrote it, as the same kind of file, and
    an input has changed since.
    """
    inputs = [path for path in spec.paths(Reads) if path.exists()]
    newest_input = max((path.stat().st_mtime_ns for path in inputs), default=0)
    read = set() if spec.in_place else {path.resolve() for path in inputs}
    for path in spec.paths(Writes):
        if path.resolve() in read:
            raise InputError(
                f"{path}: is read by {spec.step}, and would be lost if it were written; choose "
                "another --out"
            )
        if whole := _is_layer_of(path, inputs):
            raise InputError(
                f"{path}: is a layer of {whole}, which {spec.step} reads, and would be lost if it "
                "were written; choose another --out"
            )
        folder = path.parent
        if not folder.is_dir():
            raise InputError(f"{path}: folder {folder} does not exist; create it first")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{path}: folder {folder} cannot be written; check its permissions")
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name a file with --out")
        check_unprotected(path)
        if overwrite:
            continue
        if foreign := foreign_sidecar(spec, path):
            raise InputError(
                f"{foreign}: exists and was not written by usdface, and {spec.step} writes what "
                f"belongs to {path.name} there; choose another --out, or --overwrite it"
            )
        if twin := sibling_sharing_layers(spec, path):
            raise InputError(
                f"{twin}: has the same layers beneath as {path.name} would have, and would show "
                f"what {spec.step} writes; choose another --out, or --overwrite it"
            )
        if not path.exists():
            continue
        made = provenance_of(path)
        if made is None:
            raise InputError(
                f"{path}: exists and was not written by usdface; choose another --out, or "
                "--overwrite it"
            )
        if made.step != spec.step and not any({made.step, spec.step} <= each for each in _ALIKE):
            raise InputError(
                f"{path}: exists and was written by `{made.step}`, which makes something else than "
                f"{spec.step} does; choose another --out, or --overwrite it"
            )
        if path.stat().st_mtime_ns > newest_input:
            raise InputError(
                f"{path}: exists and is newer than what it is made from; choose another --out, or "
                "--overwrite it"
            )


def foreign_sidecar(spec: Spec, path: Path) -> Path | None:
    """Return the file of somebody else where a step would write a layer beneath its output."""
    if spec.step not in BESIDE:
        return None
    beside = BESIDE[spec.step](path)
    if beside == path or not beside.exists() or provenance_of(beside) is not None:
        return None
    return beside


def sibling_sharing_layers(spec: Spec, path: Path) -> Path | None:
    """Return the file that differs from an output in its ending alone, and so shares its layers."""
    if spec.step not in BESIDE or path.suffix not in LAYER_SUFFIXES:
        return None
    beside = BESIDE[spec.step](path)
    for suffix in LAYER_SUFFIXES:
        other = path.with_suffix(suffix)
        if other == path or not other.is_file():
            continue
        with contextlib.suppress(InputError):  # it cannot be read, so it shows nothing
            if beside.resolve() in {each.resolve() for each in dependencies(other)[1:]}:
                return other
    return None


def _is_layer_of(path: Path, inputs: list[Path]) -> Path | None:
    """Return the input that a file was written with: samples of a take, edits of a performance."""
    for whole in inputs:
        if path.name.startswith(f"{whole.stem}.") and path.is_file() and is_layer_name(whole):
            with contextlib.suppress(InputError):  # what cannot be read is told when it is read
                if path.resolve() in {each.resolve() for each in dependencies(whole)[1:]}:
                    return whole
    return None


def provenance_of(path: Path) -> Provenance | None:
    """Return what a file says of its making; None where it says nothing or cannot be read."""
    try:
        if path.suffix in (*LAYER_SUFFIXES, ".usdz"):
            return read_provenance(path)
        if path.suffix.lower() in IMAGE_SUFFIXES:
            from usdface.media.picture.image import (
                read_image_metadata,  # media only when there are any
            )

            return _from_metadata(read_image_metadata(path))
        if path.suffix.lower() in MOVIE_SUFFIXES:
            from usdface.media.film.movie import read_movie_comment

            return _from_text(read_movie_comment(path))
        if path.suffix.lower() in PAGE_SUFFIXES:
            from usdface.media.page.report_page import read_page_origin

            return _from_text(read_page_origin(path))
        if path.suffix.lower() == ".json":
            return _from_json(path)
        if path.suffix.lower() == ".lab":
            from usdface.speech.track_files import read_origin_beside

            return _from_metadata(read_origin_beside(path) or {})
        if path.suffix.lower() == ".textgrid":
            from usdface.speech.track_files import read_origin

            return _from_metadata(read_origin(path) or {})
    except InputError:
        return None
    return None


def make_provenance(spec: Spec) -> Provenance:
    """Hash a spec's inputs; paths are kept relative to the output, so that folders can move."""
    anchor = spec.outputs()[0].resolve().parent if spec.outputs() else Path.cwd()
    alone = set(spec.read_alone())
    inputs = {
        _relative(path, anchor): _hash(path, alone=path in alone) for path in spec.paths(Reads)
    }
    data = spec.model_dump(mode="json", exclude_defaults=True)
    for kind in (Reads, Writes):
        for name in type(spec).fields_marked(kind):
            value = getattr(spec, name)
            if isinstance(value, Path):
                data[name] = _relative(value, anchor)
            elif value is not None:
                data[name] = [_relative(each, anchor) for each in value]
    return Provenance(step=spec.step, spec=canonical_json(data), inputs=inputs)


def provenance_metadata(provenance: Provenance) -> dict[str, object]:
    """Return provenance as the metadata of an image."""
    return {
        "usdface": provenance.version,
        "step": provenance.step,
        "spec": provenance.spec,
        "inputs": dict(provenance.inputs),
    }


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


def _from_json(path: Path) -> Provenance | None:
    """Read what `evaluate` and others put beside their figures."""
    try:
        if path.stat().st_size > LARGEST_FIGURES_BYTES:
            return None
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    said = data.get("provenance") if isinstance(data, dict) else None
    return _from_metadata(said) if isinstance(said, dict) else None


def _from_text(text: str) -> Provenance | None:
    """Read what a movie carries as its comment."""
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return _from_metadata(said) if isinstance(said, dict) else None


def _hash(path: Path, *, alone: bool) -> str:
    if alone or not is_layer_name(path):
        return hash_files([path])
    return hash_files(dependencies(path))


def _relative(path: Path, anchor: Path) -> str:
    return os.path.relpath(path.resolve(), anchor).replace(os.sep, "/")
