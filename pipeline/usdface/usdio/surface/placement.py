"""Placements as layers: a marker binding on a rig, with the map of the performer's motion.

The asset is that of `usdio.surface.binding`, with its corrections; its surface consists of all
meshes of the rig, in the rig's order.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Sdf

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.usdio.authoring import apply_api, author_uniform, doubles
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.binding import read_binding, read_surface_hash, write_binding
from usdface.usdio.units import MM_PER_STAGE_UNIT

_PREFIX = "face:placement:"


@dataclass(frozen=True)
class RigPlacement:
    """Places of a performer's markers on a rig, and the map of their motion."""

    binding: MarkerBinding
    """On all meshes of the rig as one surface."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]."""
    rotation: FloatArray
    """(3, 3): from the performer's space to the rig's."""
    motion_scale: float
    """Amplitude of the motion on the rig over the performer's."""
    explained: float
    """Share of the markers' motion that the shapes explain [0-1]; NaN if unknown."""
    by_labels: bool
    """Whether the markers were placed by labels, or by motion alone."""
    left_out: tuple[str, ...] = ()
    """Deactivated markers, which no solve uses."""
    authors: Mapping[str, str] = field(default_factory=dict)
    """Author of the correction of a marker, if known."""


def write_placement(
    path: Path, placement: RigPlacement, rig: Rig, *, provenance: Provenance
) -> None:
    """Write a placement, and preserve the layer of corrections."""

    def author(root: Sdf.PrimSpec) -> None:
        kinds = Sdf.ValueTypeNames
        apply_api(root, "FacePlacementAPI")
        for name, kind, value in (
            ("markers", kinds.TokenArray, list(placement.binding.names)),
            ("neutral", kinds.DoubleArray, doubles(placement.neutral / MM_PER_STAGE_UNIT)),
            ("rotation", kinds.DoubleArray, doubles(placement.rotation)),
            ("motionScale", kinds.Double, placement.motion_scale),
            ("byLabels", kinds.Bool, placement.by_labels),
        ):
            author_uniform(root, f"{_PREFIX}{name}", kind, value)
        if np.isfinite(placement.explained):
            author_uniform(root, f"{_PREFIX}explained", kinds.Double, round(placement.explained, 6))

    write_binding(
        path,
        placement.binding,
        rig_surfaces(rig)[0],
        provenance=provenance,
        author=author,
    )


@refusing_wrong_types
def read_placement(path: Path, rig: Rig) -> RigPlacement:
    """Read a placement, with corrections."""
    surface = rig_surfaces(rig)[0]
    read = read_binding(path, surface)
    stage = open_stage(path)
    root = stage.GetDefaultPrim()
    value = {
        name: root.GetAttribute(f"{_PREFIX}{name}").Get()
        for name in ("markers", "neutral", "rotation", "motionScale", "explained", "byLabels")
    }
    row = {str(name): index for index, name in enumerate(value["markers"] or [])}
    neutral = np.array(value["neutral"] or [], np.float64)
    rotation = np.array(value["rotation"] or [], np.float64)
    scale = float(value["motionScale"] or 0.0)
    finite = np.isfinite(neutral).all() and np.isfinite(rotation).all() and np.isfinite(scale)
    whole = neutral.size == 3 * len(row) and set(read.binding.names) <= row.keys()
    if not whole or rotation.size != 9 or not finite or scale <= 0:
        raise InputError(
            f"{path}: is a binding without the map of the performer's motion, or a damaged one; "
            "make a placement with `usdface place`, which takes its corrections by --landmarks"
        )
    bound = [row[name] for name in read.binding.names]
    explained = value["explained"]
    return RigPlacement(
        binding=read.binding,
        neutral=neutral.reshape(-1, 3)[bound] * MM_PER_STAGE_UNIT,
        rotation=rotation.reshape(3, 3),
        motion_scale=scale,
        explained=float("nan") if explained is None else float(explained),
        by_labels=bool(value["byLabels"]),
        left_out=read.left_out,
        authors=read.authors,
    )


@dataclass(frozen=True)
class GivenPlaces:
    """Places of a binding's markers by people."""

    corrected: dict[str, FloatArray]
    landmarks: dict[str, FloatArray]
    """`corrected`, `landmarks`: dict of str to (3,) float array: places corrected in a stronger
    layer, and landmarks given when the binding was made [mm]."""
    left_out: tuple[str, ...]
    """Deactivated markers."""
    authors: Mapping[str, str]
    """Author of the correction of a marker, if known."""


def read_given_places(path: Path, rig: Rig) -> GivenPlaces:
    """Read the corrections and landmarks of a binding on the rig, or on one of its meshes."""
    surfaces, made_on = rig_surfaces(rig), read_surface_hash(path)
    surface = next((each for each in surfaces if each.hash == made_on), None)
    if surface is None:
        raise InputError(
            f"{path}: was made on another surface than those of {surfaces[0].file}, whose points "
            "or faces differ; give the corrections of this rig"
        )
    read = read_binding(path, surface)
    at = read.binding.places.positions(surface.mesh.points)
    given: dict[str, dict[str, FloatArray]] = {"corrected": {}, "landmark": {}, "proposed": {}}
    for row, name in enumerate(read.binding.names):
        given[read.binding.sources[row]][name] = at[row]
    return GivenPlaces(given["corrected"], given["landmark"], read.left_out, read.authors)
