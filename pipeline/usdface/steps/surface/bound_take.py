"""A cleaned take on a mesh: the binding it is given, or the one that `usdface bind` would make."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import Rig, RigMesh
from usdface.core.errors import InputError
from usdface.model.surface.binding import propose_binding
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.numerics.registration.surface_places import places_at_points
from usdface.usdio.rig.mesh import FaceMesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

_SAMPLE_FRAMES = 400
"""Frames spread over a take that binding looks at."""


@dataclass(frozen=True)
class TakeSample:
    """What binding needs of a take of any length.

    Attributes
    ----------
    names : tuple of str
    rigid : tuple of int
    neutral : (markers, 3) float array
        [mm]
    frames : tuple of int
        Numbers of the frames looked at.
    positions : (frames, markers, 3) float array
        Frames spread over the take [mm].
    visible : (frames, markers) bool array
    """

    names: tuple[str, ...]
    rigid: tuple[int, ...]
    neutral: FloatArray
    frames: tuple[int, ...]
    positions: FloatArray
    visible: BoolArray


def sample_take(take: TakeReader) -> TakeSample:
    """Read the neutral face and frames spread over a cleaned take.

    Raises
    ------
    InputError
        If the take has no markers, holds head motion, or its neutral frame lies outside it.
    """
    head = take.read(take.first_frame, take.first_frame).markers
    if head is None:
        raise InputError(f"{take.path}: has no markers; ingest a capture that has")
    if head.space != "stabilized":
        raise InputError(
            f"{take.path}: still holds head motion; run `usdface clean {take.path}` first"
        )
    if not take.first_frame <= head.neutral_frame <= take.last_frame:
        raise InputError(
            f"{take.path}: neutral frame {head.neutral_frame} is outside the take, "
            f"{take.first_frame}-{take.last_frame}; clean it with --neutral"
        )
    count = take.last_frame - take.first_frame + 1
    picks = np.unique(np.linspace(take.first_frame, take.last_frame, min(count, _SAMPLE_FRAMES)))
    parts = []
    for frame in [head.neutral_frame, *picks.astype(int).tolist()]:
        markers = take.read(frame, frame).markers
        if markers is not None:
            parts.append(markers)
    return TakeSample(
        names=head.names,
        rigid=tuple(head.names.index(name) for name in head.rigid),
        neutral=parts[0].positions[0].astype(np.float64),
        frames=tuple(picks.astype(int).tolist()),
        positions=np.concatenate([each.positions for each in parts[1:]]).astype(np.float64),
        visible=np.concatenate([each.visible | (each.confidence > 0) for each in parts[1:]]),
    )


def bind_take(
    sample: TakeSample,
    face: FaceMesh,
    *,
    pinned: dict[int, FloatArray] | None = None,
    sources: dict[int, str] | None = None,
) -> MarkerBinding:
    """Propose a binding, with the shapes of the mesh where its file is a rig."""
    return propose_binding(
        add_shapes(face),
        names=sample.names,
        neutral=sample.neutral,
        positions=sample.positions,
        visible=sample.visible,
        rigid=sample.rigid,
        pinned=pinned,
        sources=sources,
    )


def add_shapes(face: FaceMesh) -> RigMesh:
    """Return the mesh with the shapes it has in its rig, or as it is where it has none."""
    try:
        rig: Rig = read_rig(face.file, prim=None)
    except InputError:
        return face.mesh
    found = [mesh for mesh in rig.meshes if mesh.path == face.path]
    return replace(face.mesh, shapes=found[0].shapes) if found else face.mesh


def landmark_places(
    landmarks: tuple[str, ...], names: tuple[str, ...], face: FaceMesh, take: Path
) -> dict[int, FloatArray]:
    """Return where each named marker is on the mesh, from NAME=POINT.

    Raises
    ------
    InputError
        If a name is not the take's, or a point not the mesh's; every fault is named.
    """
    faults, found = [], {}
    for landmark in landmarks:
        name, _, number = landmark.rpartition("=")
        point = int(number)
        if name not in names:
            faults.append(f"{take}: has no marker {name!r}; it has {', '.join(names[:6])}, ...")
        elif point >= len(face.mesh.points):
            faults.append(
                f"{face.file} <{face.path}>: has no point {point} for {name}, only "
                f"{len(face.mesh.points)}"
            )
        else:
            try:
                at = places_at_points(
                    face.mesh.face_counts, face.mesh.face_indices, np.array([point])
                )
            except ValueError as error:
                faults.append(f"{face.file} <{face.path}>: landmark {name}: {error}")
                continue
            found[names.index(name)] = at.positions(face.mesh.points)[0]
    if faults:
        raise InputError("; ".join(faults))
    return found
