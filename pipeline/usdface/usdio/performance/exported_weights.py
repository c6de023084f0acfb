"""Weights exported by Blender and Maya, with one channel per shape and mesh.

In Blender shape keys belong to a mesh: its exporter names the channel of the second mesh's
``jawOpen`` ``jawOpen2``, converts names to identifiers, and writes one animation per mesh unless
they have a common armature. Maya names channels after mesh, deformer and shape:
``_skin_Deformer_jawOpen``. BlendShape prims have the shapes' names in both.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader, animations_of_skeletons
from usdface.usdio.rig.read import channel_shapes, channels_per_mesh

MAKER = "Blender"
"""Prefix of the documentation of an exported layer: ``Blender v5.0.1``."""


@dataclass(frozen=True)
class MeshCurve:
    """A shape's weights on one mesh."""

    mesh: str
    """The prim's name."""
    values: FloatArray
    """(frames,)"""


@dataclass(frozen=True)
class ExportedWeights:
    """Weights of shapes on all meshes that have them."""

    names: tuple[str, ...]
    """Of the BlendShape prims: identifiers (`blender_names`)."""
    curves: tuple[tuple[MeshCurve, ...], ...]
    """By shape; the mesh with the most shapes first."""
    reader: PerformanceReader
    """Of the first animation; all have the same frames."""


def blender_names(name: str) -> tuple[str, str]:
    """Return the identifiers of a shape key's name by Blender's exporter: from 5.0, and before."""
    as_ascii = name.encode("utf-8").decode("ascii", errors="replace")  # a character for each byte
    return _identifier(name), _identifier(as_ascii)


def is_of_blender(path: Path) -> bool:
    """Whether Blender wrote a file."""
    return bool(open_stage(path).GetRootLayer().documentation.startswith(MAKER))


@refusing_wrong_types
def has_channels_per_mesh(path: Path) -> bool:
    """Whether a shape has several channels, named after mesh and shape."""
    stage = open_stage(path)
    animations = list(animations_of_skeletons(stage).values())
    if len(animations) != 1:
        return False
    channels = channels_per_mesh(_meshes(stage, animations[0].GetPath()))
    return any(len(of_shape) > 1 for of_shape in channels.values())


@refusing_wrong_types
def read_exported_weights(path: Path) -> ExportedWeights | None:
    """Read weights by the shapes that channels drive; None without meshes."""
    stage = open_stage(path)
    readers = [PerformanceReader(path, animation=each) for each in _animations(stage, path)]
    first = readers[0]
    by_mesh: list[tuple[int, str, dict[str, FloatArray]]] = []
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
            shape_of = channel_shapes(mesh).items()
            of_mesh = {shape: columns[name] for name, shape in shape_of if name in columns}
            by_mesh.append((len(of_mesh), mesh.GetPrim().GetName(), of_mesh))
    curves: dict[str, list[MeshCurve]] = {}
    for _, mesh_name, of_mesh in sorted(by_mesh, key=lambda mesh: (-mesh[0], mesh[1])):
        for shape, column in of_mesh.items():
            curves.setdefault(shape, []).append(MeshCurve(mesh_name, column))
    if not curves:
        return None
    return ExportedWeights(tuple(curves), tuple(map(tuple, curves.values())), first)


def _identifier(name: str) -> str:
    identifier = re.sub(r"\W", "_", name)
    return f"_{identifier}" if identifier[:1].isdigit() else identifier


def _animations(stage: Usd.Stage, path: Path) -> list[Sdf.Path | None]:
    """Return the animations of the face; None for the only one."""
    paths = [each.GetPath() for each in animations_of_skeletons(stage).values()]
    if len(paths) < 2:
        return [None]
    prefix = paths[0]
    for path_of in paths[1:]:
        prefix = prefix.GetCommonPrefix(path_of)
    # Below the exporter's root prim, meshes with one animation each are parts of one face.
    one_mesh_each = all(len(_meshes(stage, each)) == 1 for each in paths)
    if not one_mesh_each or prefix.pathElementCount < 2:
        raise InputError(
            f"{path}: {len(paths)} animations with blendShapeWeights, "
            f"{', '.join(map(str, paths))}; export one face at a time"
        )
    return list(paths)


def _meshes(stage: Usd.Stage, animation: Sdf.Path) -> list[UsdSkel.BindingAPI]:
    bindings = []
    for prim in stage.Traverse():
        binding = UsdSkel.BindingAPI(prim)
        skeleton = binding.GetInheritedSkeleton() if binding.GetBlendShapesAttr() else None
        if skeleton and binding.GetBlendShapeTargetsRel().HasAuthoredTargets():
            source = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
            if source and source.GetPath() == animation:
                bindings.append(binding)
    return bindings
