"""Weights as Blender and Maya export them: a shape once per mesh, by names that they make up.

Shape keys belong to a mesh there. Its exporter gives the second mesh's ``jawOpen`` a channel
``jawOpen2``, makes identifiers of all names, and writes an animation per mesh where no armature
holds them together. Maya's names a channel after mesh, deformer and shape:
``_skin_Deformer_jawOpen``. Both keep the shapes' names on the BlendShape prims.
"""

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader, animations_of_skeletons
from usdface.usdio.rig.read import channels_per_mesh

MAKER = "Blender"
"""The exporter's documentation of a layer starts with it: ``Blender v5.0.1``."""


@dataclass(frozen=True)
class MeshCurve:
    """A shape's weights as one mesh shows them."""

    mesh: str
    """The prim's name."""
    values: FloatArray
    """(frames,)"""


@dataclass(frozen=True)
class ExportedWeights:
    """Weights of shapes as every mesh that has them shows them."""

    names: tuple[str, ...]
    """Of the BlendShape prims: identifiers (`blender_names`)."""
    curves: tuple[tuple[MeshCurve, ...], ...]
    """By shape; that of the mesh with the most shapes first."""
    frames: tuple[int, ...]
    rate: Fraction
    keyed: frozenset[int]


def blender_names(name: str) -> tuple[str, str]:
    """Return what Blender's exporter makes of a shape key's name: from 5.0, and before."""
    as_ascii = name.encode("utf-8").decode("ascii", errors="replace")  # a character for each byte
    return _identifier(name), _identifier(as_ascii)


def is_of_blender(path: Path) -> bool:
    """Whether Blender wrote a file."""
    return bool(open_stage(path).GetRootLayer().documentation.startswith(MAKER))


@refusing_wrong_types
def has_channels_per_mesh(path: Path) -> bool:
    """Whether channels are named after mesh and shape, so that one shape has several."""
    stage = open_stage(path)
    animations = list(animations_of_skeletons(stage).values())
    if len(animations) != 1:
        return False
    found = channels_per_mesh(_meshes(stage, animations[0].GetPath()))
    return any(len(each) > 1 for each in found.values())


@refusing_wrong_types
def read_exported_weights(path: Path) -> ExportedWeights | None:
    """Read weights by the shapes that channels drive; None where no mesh tells."""
    stage = open_stage(path)
    readers = [PerformanceReader(path, animation=each) for each in _animations(stage, path)]
    first = readers[0]
    found: list[tuple[int, str, dict[str, FloatArray]]] = []
    for reader in readers:
        if (reader.first_frame, reader.last_frame) != (first.first_frame, first.last_frame):
            raise InputError(
                f"{path}: {reader.animation.GetPath()} has frames {reader.first_frame}-"
                f"{reader.last_frame}, {first.animation.GetPath()} {first.first_frame}-"
                f"{first.last_frame}; export all meshes over the same frames"
            )
        values = reader.edited().astype(np.float64)
        columns = dict(zip(reader.names, values.T, strict=True))
        for mesh in _meshes(stage, reader.animation.GetPath()):
            shapes = _shapes_of_channels(mesh)
            own = {shape: columns[name] for name, shape in shapes.items() if name in columns}
            found.append((len(own), mesh.GetPrim().GetName(), own))
    curves: dict[str, list[MeshCurve]] = {}
    for _, mesh_name, own in sorted(found, key=lambda each: (-each[0], each[1])):
        for shape, column in own.items():
            curves.setdefault(shape, []).append(MeshCurve(mesh_name, column))
    if not curves:
        return None
    return ExportedWeights(
        tuple(curves),
        tuple(map(tuple, curves.values())),
        tuple(first.frames.tolist()),
        first.rate,
        first.keyed_frames,
    )


def _identifier(name: str) -> str:
    identifier = re.sub(r"\W", "_", name)
    return f"_{identifier}" if identifier[:1].isdigit() else identifier


def _animations(stage: Usd.Stage, path: Path) -> list[Sdf.Path | None]:
    """Return the animations of the one face; None for the only one."""
    found = [each.GetPath() for each in animations_of_skeletons(stage).values()]
    if len(found) < 2:
        return [None]
    together = found[0]
    for each in found[1:]:
        together = together.GetCommonPrefix(each)
    # Below the exporter's root prim, meshes with an animation each are parts of one face.
    alone = all(len(_meshes(stage, each)) == 1 for each in found)
    if not alone or together.pathElementCount < 2:
        raise InputError(
            f"{path}: {len(found)} animations with blendShapeWeights, "
            f"{', '.join(map(str, found))}; export one face at a time"
        )
    return list(found)


def _meshes(stage: Usd.Stage, animation: Sdf.Path) -> list[UsdSkel.BindingAPI]:
    found = []
    for prim in stage.Traverse():
        binding = UsdSkel.BindingAPI(prim)
        skeleton = binding.GetInheritedSkeleton() if binding.GetBlendShapesAttr() else None
        if skeleton and binding.GetBlendShapeTargetsRel().HasAuthoredTargets():
            source = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
            if source and source.GetPath() == animation:
                found.append(binding)
    return found


def _shapes_of_channels(mesh: UsdSkel.BindingAPI) -> dict[str, str]:
    """Return the name of the shape key that each channel drives on a mesh."""
    targets = mesh.GetBlendShapeTargetsRel().GetTargets()
    channels = map(str, mesh.GetBlendShapesAttr().Get() or ())
    return dict(zip(channels, (each.name for each in targets), strict=False))
