"""Read known positions of markers on a rig: from a table, or corrections of a binding."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from usdface.capture.text_table import csv_rows
from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.sidecars import is_usd_name
from usdface.core.text import first_few, read_json
from usdface.numerics.surface.surface_places import nearest_places
from usdface.usdio.layers import open_stage
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.placement import read_given_places
from usdface.usdio.units import stage_to_ours

_LARGEST_BYTES = 1 << 20
_FORM = (
    "a CSV table with the columns marker and point, or marker, x, y and z; or JSON, as "
    '{"nose": 120}'
)


def read_landmarks(path: Path | None, names: Sequence[str], rig: Rig) -> dict[str, FloatArray]:
    """Return the position on the rig of each marker in a file [mm]; none without a file.

    `path`: .csv with the columns ``marker`` and ``point``, or ``marker``, ``x``, ``y``, ``z``;
    .json with a point or [x, y, z] by marker; or USD, whose corrections are used. A point is an
    index, ``MESH:INDEX`` if the rig has several meshes; x, y, z are in the rig's units.
    """
    if path is None:
        return {}
    if is_usd_name(path):
        places = read_given_places(path, rig)
        every = {**places.landmarks, **places.corrected}
        given = {name: at for name, at in every.items() if name in names}
        if not given:
            raise InputError(
                f"{path}: has no corrections of the takes' markers; move the balls of some, or "
                "leave out --landmarks"
            )
        return given
    faults: list[str] = []
    found: dict[str, FloatArray] = {}
    for where, name, value in _rows(path):
        if name not in names:
            faults.append(
                f"{where}: the takes have no marker {name!r}; they have {first_few(names)}"
            )
            continue
        if name in found:
            faults.append(f"{where}: {name} is a duplicate; keep one")
            continue
        try:
            found[name] = _landmark_position(value, rig)
        except ValueError as error:
            faults.append(f"{where}: {name}: {error}")
    if faults:
        raise InputError(f"{path}: {first_few(faults, between='; ')}")
    if not found:
        raise InputError(f"{path}: names no landmark; write {_FORM}")
    return found


def _rows(path: Path) -> list[tuple[str, str, object]]:
    """Return (location, marker, value) of each row."""
    if path.suffix.lower() == ".json":
        data = read_json(path, _LARGEST_BYTES)
        if not isinstance(data, dict):
            raise InputError(f"{path}: names no marker; write {_FORM}")
        return [("entry", str(name), value) for name, value in data.items()]
    rows = csv_rows(path, ("marker",))
    if rows and not ("point" in rows[0][1] or set("xyz") <= rows[0][1].keys()):
        raise InputError(f"{path} line 1: needs other columns; write {_FORM}")
    return [
        (where, str(row["marker"]).strip(), row.get("point") or [row.get(axis) for axis in "xyz"])
        for where, row in rows
    ]


def _landmark_position(value: object, rig: Rig) -> FloatArray:
    """Return a position on the rig [mm]."""
    if isinstance(value, list):
        return _at_position(value, rig)
    mesh_name, _, number = str(value).strip().rpartition(":")
    meshes = [
        mesh for mesh in rig.meshes if mesh_name in ("", mesh.path, mesh.path.rpartition("/")[2])
    ]
    if len(meshes) != 1:
        listed = first_few(mesh.path.rpartition("/")[2] for mesh in rig.meshes)
        raise ValueError(f"point {value!r} must be MESH:INDEX, with one of the meshes {listed}")
    if not number.isdecimal() or int(number) >= len(meshes[0].points):
        raise ValueError(
            f"<{meshes[0].path}> has no point {number}; it has points 0 to "
            f"{len(meshes[0].points) - 1}"
        )
    return np.asarray(meshes[0].points[int(number)], np.float64)


def _at_position(value: Sequence[object], rig: Rig) -> FloatArray:
    try:
        given = [float(str(each)) for each in value]
    except ValueError:
        given = []
    if len(given) != 3 or not all(map(math.isfinite, given)):
        raise ValueError(f"{value} is neither a point nor x, y, z; give one of these")
    at = stage_to_ours(open_stage(rig.file)) @ given
    surface = rig_surfaces(rig)[0]
    mesh = surface.mesh
    on_it = nearest_places(mesh.points, mesh.face_counts, mesh.face_indices, at[None])
    away = float(np.linalg.norm(on_it.positions(mesh.points)[0] - at))
    if away > surface.reach_mm:
        raise ValueError(
            f"{given[0]:g}, {given[1]:g}, {given[2]:g}, in the rig's units and axes, is {away:.0f} "
            "mm from its surface; give a position on it"
        )
    return at
