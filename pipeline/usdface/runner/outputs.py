"""Checks before a step runs: whether inputs exist, and outputs may be written."""

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from usdface.core.confinement import check_confined, check_no_loop, confinement_root
from usdface.core.errors import InputError
from usdface.core.replacing import check_unprotected
from usdface.core.sidecars import LAYER_SUFFIXES, corrected_path
from usdface.core.text import first_few
from usdface.runner.origin import REFUSED_SUFFIX, input_files, provenance_of, traced_files
from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP, JobSpec
from usdface.specs.paths import Reads, Writes
from usdface.usdio.layers import check_asset_name, is_layer_name
from usdface.usdio.referenced_files import all_files, dependencies


def confine(what: str, *, reads: Sequence[Path] = (), writes: Sequence[Path] = ()) -> None:
    """Refuse inputs of a command without a spec that are no files, as `check_may_be_read` does.

    And all paths outside the folder of ``USDFACE_ROOT``, if set.
    """
    for path in (*reads, *writes):
        check_no_loop(path)
    check_confined([(what, path) for path in (*reads, *writes)])
    _check_layers(what, reads)
    _check_files(what, reads)


def _check_layers(what: str, paths: Sequence[Path]) -> None:
    root = confinement_root()
    if root is None:
        return
    top = root.resolve()
    faults = []
    for path in paths:
        # As USD recognises layers, not by suffix: packages and X.USDA are layers.
        if path.is_file() and is_layer_name(path):
            faults += [
                f"{what}: {path}: refers to {file}, which lies outside {root}"
                for file in all_files(path)
                if not file.resolve().is_relative_to(top)
            ]
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files into it, or give another root")


def check_inputs(spec: Spec) -> None:
    """Refuse a spec with missing inputs, naming all of them."""
    check_may_be_read(spec)
    if missing := missing_inputs(spec):
        raise InputError(f"{first_few(missing)}: no such file; check the path")


def missing_inputs(spec: Spec) -> list[Path]:
    """Return the inputs of a spec that do not exist."""
    return [path for path in spec.paths(Reads) if not path.exists()]


def missing_in_job(job: JobSpec) -> list[str]:
    """Return a message for each input of a job that neither exists nor is made by earlier steps."""
    made: set[Path] = set()
    faults = []
    for number, spec in enumerate(job.steps, start=1):
        faults += [
            f"step {number}, {spec.step}: {path}: no such file, and no earlier step makes it"
            for path in missing_inputs(spec)
            if path not in made
        ]
        made.update(spec.changes())
    return faults


def check_may_be_read(spec: Spec) -> None:
    """Refuse paths outside the folder of ``USDFACE_ROOT``, and inputs that are no files.

    To be called before any input is opened.
    """
    writes = dict.fromkeys((*spec.paths(Writes), *spec.changes()))
    confine(spec.step, reads=spec.paths(Reads), writes=list(writes))


def _check_files(what: str, paths: Sequence[Path]) -> None:
    # Reading a pipe or a device may block forever.
    no_files = [path for path in paths if path.exists() and not path.is_file()]
    if folders := [path for path in no_files if path.is_dir()]:
        raise InputError(
            f"{first_few(folders)}: a folder; {what} reads files: name them, such as "
            f"{folders[0] / '*'}"
        )
    if no_files:
        raise InputError(f"{first_few(no_files)}: a pipe or a device, not a file; copy it to one")


def check_outputs(spec: Spec, *, overwrite: bool) -> None:
    """Refuse outputs that cannot be written, or that would replace another file.

    Without `overwrite`, a file is replaced only if this package wrote it, as the same kind of file,
    and an input or one of its layers is newer.
    """
    marks = {**traced_files(spec), **spec.reads()}
    inputs = [path for path in marks if path.exists()]
    read = set() if spec.in_place else {path.resolve() for path in inputs}
    for path in spec.paths(Writes):
        if path.resolve() in read:
            raise InputError(
                f"{path}: is an input of {spec.step}, and would be overwritten; choose another "
                "--out"
            )
        if whole := _is_layer_of(path, inputs):
            raise InputError(
                f"{path}: is a layer of {whole}, an input of {spec.step}, and would be "
                "overwritten; choose another --out"
            )
        check_asset_name(path)
        folder = path.parent
        if not folder.is_dir():
            raise InputError(
                f"{path}: folder {folder} does not exist; create it first, or run a job with "
                "--make-folders"
            )
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{path}: folder {folder} cannot be written; check its permissions")
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name a file with --out")
        check_unprotected(path)
    if overwrite:
        return
    check_may_be_replaced(spec)
    outputs = [path for path in spec.paths(Writes) if path.exists()]
    newest_input = _newest_input_ns(spec, {path: marks[path] for path in inputs}) if outputs else 0
    for path in outputs:
        if path.stat().st_mtime_ns > newest_input:
            raise InputError(
                f"{path}: exists and is newer than its inputs; choose another --out, or "
                "--overwrite it"
            )


def _newest_input_ns(spec: Spec, inputs: Mapping[Path, Reads]) -> int:
    """Return the latest time of change of the inputs, with the layers that they compose [ns]."""
    files = [file for path, how in inputs.items() for file in input_files(path, how)]
    if (binding := spec.written_binding()) is not None:
        files.append(corrected_path(binding))  # also if its last correction was removed
    return max((file.stat().st_mtime_ns for file in files if file.exists()), default=0)


def check_may_be_replaced(spec: Spec) -> None:
    """Refuse outputs that would replace files of other programs or other kinds of step."""
    for path in spec.paths(Writes):
        for layer in sidecars_of(spec, path):
            if layer.exists() and provenance_of(layer) is None:
                raise InputError(
                    f"{layer}: exists and was not written by usdface, and {spec.step} writes a "
                    f"layer of {path.name} there; choose another --out, or --overwrite it"
                )
        if sibling := sibling_sharing_layers(spec, path):
            raise InputError(
                f"{sibling}: has the same sublayers as {path.name} would have, and would change "
                "with it; choose another --out, or --overwrite it"
            )
        if not path.exists():
            continue
        made = provenance_of(path)
        if made is None:
            raise InputError(
                f"{path}: exists and was not written by usdface; choose another --out, or "
                "--overwrite it"
            )
        writer = SPEC_BY_STEP.get(made.step.removesuffix(REFUSED_SUFFIX))
        if writer is None or writer.kind_of_output() != spec.kind_of_output():
            raise InputError(
                f"{path}: exists and was written by `{made.step}`, whose outputs {spec.step} does "
                "not replace; choose another --out, or --overwrite it"
            )


def sidecars_of(spec: Spec, path: Path) -> list[Path]:
    """Return the sublayers that a step writes for an output."""
    return [layer for rule in type(spec).sidecars if (layer := rule(path)) != path]


def sibling_sharing_layers(spec: Spec, path: Path) -> Path | None:
    """Return a file that shares the sublayers of an output, as it differs only in its suffix."""
    sidecars = {layer.resolve() for layer in sidecars_of(spec, path)}
    if not sidecars or path.suffix not in LAYER_SUFFIXES:
        return None
    for suffix in LAYER_SUFFIXES:
        other = path.with_suffix(suffix)
        if other == path or not other.is_file():
            continue
        with contextlib.suppress(InputError):  # unreadable, so nothing can depend on it
            if sidecars & {each.resolve() for each in dependencies(other)[1:]}:
                return other
    return None


def _is_layer_of(path: Path, inputs: list[Path]) -> Path | None:
    """Return the input that a file is a sublayer of, as the samples of a take."""
    for whole in inputs:
        if path.name.startswith(f"{whole.stem}.") and path.is_file() and is_layer_name(whole):
            with contextlib.suppress(InputError):  # reported when the step reads it
                if path.resolve() in {each.resolve() for each in dependencies(whole)[1:]}:
                    return whole
    return None
