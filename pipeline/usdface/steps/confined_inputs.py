"""A layer may name files of its own: those, too, must lie below the folder that confines."""

from pathlib import Path

from usdface.errors import InputError
from usdface.specs.base import LAYER_SUFFIXES, Reads, Spec
from usdface.specs.confinement import check_confined
from usdface.usdio.layers import all_files


def check_confined_inputs(spec: Spec, root: Path) -> None:
    """Refuse a spec with a path outside a folder, or with a layer that refers to one.

    Raises
    ------
    InputError
        Naming every such path.
    """
    check_confined((spec,), root)
    top = root.resolve()
    faults = []
    for path in spec.paths(Reads):
        if path.is_file() and path.suffix in LAYER_SUFFIXES:
            faults += [
                f"{spec.step}: {path}: refers to {file}, which lies outside {root}"
                for file in all_files(path)
                if not file.resolve().is_relative_to(top)
            ]
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files below it, or ask for another root")
