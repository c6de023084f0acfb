"""Names of files that accompany another, for specs, steps and layers."""

import hashlib
from collections.abc import Callable
from pathlib import Path

LAYER_SUFFIXES = (".usda", ".usdc", ".usd")


def is_usd_name(path: Path) -> bool:
    """Whether a file name is that of a USD layer or package."""
    return path.suffix.lower() in (*LAYER_SUFFIXES, ".usdz")


def _with_ending(ending: str) -> Callable[[Path], Path]:
    """Return the function from NAME.SUFFIX to NAME.ENDING."""
    return lambda path: path.with_name(f"{path.stem}.{ending}")


weights_path = _with_ending("weights.usdc")
"""The layer with the solve of a performance."""
edits_path = _with_ending("edits.usda")
"""The layer with a performance's edits."""
notes_path = _with_ending("notes.json")
"""The file of review notes on a performance."""
controls_path = _with_ending("controls.usdc")
"""The layer with a performance's joints and attributes."""
head_path = _with_ending("head.usdc")
"""The layer with a performance's head and eye motion."""
points_path = _with_ending("points.usdc")
"""The layer with the points of a deformed mesh."""
parts_folder = _with_ending("parts")
"""The folder of a file's parts on a farm."""

proposed_path = _with_ending("proposed.usda")
"""The layer with the proposals of references, pairs or a binding."""
corrected_path = _with_ending("corrected.usda")
"""The layer with corrections of a binding."""

tuned_path = _with_ending("tuned.usda")
"""The layer with the tuned weights of a references asset."""
coverage_path = _with_ending("coverage.png")
"""The picture of the coverage of a selection."""
placement_path = _with_ending("placement.usda")
"""The placement of markers on the rig that `select` writes with references."""
lock_path = _with_ending("tuned.lock")
"""The tuning lock of a references asset."""
journal_path = _with_ending("tuned.journal")
"""The journal of changes that are not yet in the tuned layer."""
poses_path = _with_ending("poses.json")
"""The file of poses saved during the tuning of a references asset."""
images_folder = _with_ending("images")
"""The folder with the pictures of a references asset."""


def samples_path(asset: Path) -> Path:
    """Return the layer with the arrays of a take or references.

    NAME.samples.usdc of NAME.usda; a binary asset has its own.
    """
    return asset if asset.suffix == ".usdc" else asset.with_name(f"{asset.stem}.samples.usdc")


def binding_layers(binding: Path) -> tuple[Path, Path, Path]:
    """Return the files of a binding or a placement: the top layer and its sublayers."""
    return binding, proposed_path(binding), corrected_path(binding)


def reference_layers(references: Path) -> tuple[Path, ...]:
    """Return the files of a references asset: the top layer and its sublayers."""
    sublayers = (tuned_path(references), proposed_path(references), samples_path(references))
    return tuple(dict.fromkeys((references, *sublayers)))


def work_folder(out: Path, purpose: str) -> Path:
    """Return a hidden folder for intermediate files of an output, unique to it.

    `purpose`: suffix of its name.
    """
    digest = hashlib.sha256(out.name.encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return out.with_name(f".{out.stem[:40]}.{digest}.{purpose}")
