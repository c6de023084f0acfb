"""A layer may name files of its own: those, too, must lie below the folder that confines."""

from collections.abc import Sequence
from pathlib import Path

from usdface.core.errors import InputError
from usdface.specs.base import Spec
from usdface.specs.paths import Reads, check_confined, confinement_root
from usdface.usdio.layers import is_layer_name
from usdface.usdio.referenced_files import all_files


def check_confined_inputs(spec: Spec, root: Path) -> None:
    """Refuse a spec with a path outside a folder, or with a layer that refers to one.

    Raises
    ------
    InputError
        Naming every such path.
    """
    check_confined(spec.named_paths(), root)
    _check_layers(spec.step, spec.paths(Reads), root)


def confine(what: str, *, reads: Sequence[Path] = (), writes: Sequence[Path] = ()) -> None:
    """Hold a command that has no spec to the folder that ``USDFACE_ROOT`` names, if it does.

    Parameters
    ----------
    what : str
        The command.

    Raises
    ------
    InputError
        Naming every path outside, those that layers refer to included.
    """
    root = confinement_root()
    if root is not None:
        check_confined([(what, path) for path in (*reads, *writes)], root)
        _check_layers(what, reads, root)


def _check_layers(what: str, paths: Sequence[Path], root: Path) -> None:
    top = root.resolve()
    faults = []
    for path in paths:
        # As USD tells a layer, not by a list of endings: packages are layers, and so is X.USDA.
        if path.is_file() and is_layer_name(path):
            faults += [
                f"{what}: {path}: refers to {file}, which lies outside {root}"
                for file in all_files(path)
                if not file.resolve().is_relative_to(top)
            ]
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files below it, or ask for another root")
