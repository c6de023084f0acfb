"""Names of files that accompany another, for specs, steps and layers."""

import hashlib
from pathlib import Path

LAYER_SUFFIXES = (".usda", ".usdc", ".usd")


def is_usd_name(path: Path) -> bool:
    """Whether a file name is that of a USD layer or package."""
    return path.suffix.lower() in (*LAYER_SUFFIXES, ".usdz")


def weights_path(performance: Path) -> Path:
    """Return the layer with the solve of a performance: NAME.weights.usdc beside NAME.usda."""
    return performance.with_name(f"{performance.stem}.weights.usdc")


def edits_path(performance: Path) -> Path:
    """Return the layer with a performance's edits: NAME.edits.usda."""
    return performance.with_name(f"{performance.stem}.edits.usda")


def notes_path(performance: Path) -> Path:
    """Return the file of review notes on a performance: NAME.notes.json."""
    return performance.with_name(f"{performance.stem}.notes.json")


def controls_path(performance: Path) -> Path:
    """Return the layer with a performance's joints and attributes: NAME.controls.usdc."""
    return performance.with_name(f"{performance.stem}.controls.usdc")


def head_path(performance: Path) -> Path:
    """Return the layer with a performance's head and eye motion: NAME.head.usdc."""
    return performance.with_name(f"{performance.stem}.head.usdc")


def points_path(deformed: Path) -> Path:
    """Return the layer with the points of a deformed mesh: NAME.points.usdc."""
    return deformed.with_name(f"{deformed.stem}.points.usdc")


def parts_folder(out: Path) -> Path:
    """Return the folder of a file's parts on a farm: NAME.parts."""
    return out.with_name(f"{out.stem}.parts")


def samples_path(asset: Path) -> Path:
    """Return the layer with the arrays of a take or references.

    NAME.samples.usdc of NAME.usda; a binary asset has its own.
    """
    return asset if asset.suffix == ".usdc" else asset.with_name(f"{asset.stem}.samples.usdc")


def proposed_path(asset: Path) -> Path:
    """Return the layer with the proposals of references, pairs or a binding."""
    return asset.with_name(f"{asset.stem}.proposed.usda")


def corrected_path(binding: Path) -> Path:
    """Return the layer with corrections of a binding."""
    return binding.with_name(f"{binding.stem}.corrected.usda")


def binding_layers(binding: Path) -> tuple[Path, Path, Path]:
    """Return the files of a binding or a placement: the top layer and its sublayers."""
    return binding, proposed_path(binding), corrected_path(binding)


def tuned_path(references: Path) -> Path:
    """Return the layer with the tuned weights of a references asset."""
    return references.with_name(f"{references.stem}.tuned.usda")


def coverage_path(references: Path) -> Path:
    """Return the picture of the coverage of a selection: NAME.coverage.png."""
    return references.with_name(f"{references.stem}.coverage.png")


def reference_layers(references: Path) -> tuple[Path, ...]:
    """Return the files of a references asset: the top layer and its sublayers."""
    sublayers = (tuned_path(references), proposed_path(references), samples_path(references))
    return tuple(dict.fromkeys((references, *sublayers)))


def placement_path(references: Path) -> Path:
    """Return the placement of markers on the rig that `select` writes with references."""
    return references.with_name(f"{references.stem}.placement.usda")


def lock_path(references: Path) -> Path:
    """Return the tuning lock of a references asset."""
    return references.with_name(f"{references.stem}.tuned.lock")


def journal_path(references: Path) -> Path:
    """Return the journal of changes that are not yet in the tuned layer."""
    return references.with_name(f"{references.stem}.tuned.journal")


def poses_path(references: Path) -> Path:
    """Return the file of poses saved during the tuning of a references asset."""
    return references.with_name(f"{references.stem}.poses.json")


def images_folder(references: Path) -> Path:
    """Return the folder with the pictures of a references asset."""
    return references.with_name(f"{references.stem}.images")


def work_folder(out: Path, purpose: str) -> Path:
    """Return a hidden folder for intermediate files of an output, unique to it.

    Parameters
    ----------
    purpose : str
        Suffix of its name.
    """
    digest = hashlib.sha256(out.name.encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return out.with_name(f".{out.stem[:40]}.{digest}.{purpose}")


def distances_path(output: Path, mesh_file: Path, surface_hash: str) -> Path:
    """Return the cache of the distances over a surface, in the folder of a step's output."""
    return output.with_name(f"{mesh_file.stem}.{surface_hash[:8]}.distances.usdc")
