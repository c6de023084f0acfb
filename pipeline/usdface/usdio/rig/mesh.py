"""Reading of meshes at rest, and transforms between their space and ours."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig, RigMesh, point_slices
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.authoring import check_not_instanced, prim_or_root, prims_below
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.units import column_matrix, rest_transforms, stage_to_ours, transform_points


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh at rest and the linear maps of its offsets."""

    points: FloatArray
    """(n, 3) [mm]"""
    linear: FloatArray
    """(n, 3, 3) or (3, 3): from offsets in mesh space to ours; per point if skinning bends the
    mesh."""

    def offsets(self, points: IntArray, offsets: FloatArray) -> FloatArray:
        """Return offsets of some points in millimetres, Y up, from those in mesh space."""
        if self.linear.ndim == 2:
            return np.asarray(offsets @ self.linear.T)
        return np.asarray(np.einsum("nij,nj->ni", self.linear[points], offsets))

    def normals(self, normals: FloatArray, points: IntArray | None = None) -> FloatArray:
        """Return normals, or their offsets, in our space, of some points or of all.

        Their lengths are preserved under rotation and uniform scale.
        """
        linear = self.linear
        if linear.ndim == 3 and points is not None:
            linear = linear[points]
        volume = np.abs(np.linalg.det(linear))
        if not np.all(volume > 0):
            return normals  # a flattened mesh
        # Normals transform by the inverse transpose.
        inverse = np.linalg.inv(linear) * np.cbrt(volume)[..., None, None]
        if inverse.ndim == 2:
            return np.asarray(normals @ inverse)
        return np.asarray(np.einsum("nji,nj->ni", inverse, normals))


def skel_bindings(
    cache: UsdSkel.Cache, root: UsdSkel.Root
) -> dict[str, tuple[UsdSkel.SkeletonQuery, UsdSkel.SkinningQuery]]:
    """Return skeleton and skinning of each skinned mesh below a SkelRoot, by its path."""
    predicate = Usd.TraverseInstanceProxies()
    cache.Populate(root, predicate)
    return {
        str(target.GetPrim().GetPath()): (cache.GetSkelQuery(binding.GetSkeleton()), target)
        for binding in cache.ComputeSkelBindings(root, predicate)
        for target in binding.GetSkinningTargets()
    }


def still_meshes(root: UsdSkel.Root) -> dict[str, str]:
    """Return why USD does not animate a mesh with BlendShapes below a SkelRoot, by its path."""
    moved = skel_bindings(UsdSkel.Cache(), root)
    return {
        str(mesh.GetPath()): _why_still(mesh)
        for mesh in prims_below(root.GetPrim(), UsdGeom.Mesh)
        if UsdSkel.BindingAPI(mesh).GetBlendShapesAttr().Get()
        and UsdSkel.BindingAPI(mesh).GetInheritedSkeleton()
        and str(mesh.GetPath()) not in moved
    }


def _why_still(mesh: Usd.Prim) -> str:
    above = mesh.GetParent()
    while above and above.IsA(UsdGeom.Imageable):
        above = above.GetParent()
    if above and not above.IsPseudoRoot():
        kind = f"type {above.GetTypeName()}" if above.GetTypeName() else "no type"
        return (
            f"USD does not animate it, as <{above.GetPath()}> above it has {kind}; "
            "make that prim an Xform or a Scope"
        )
    if not mesh.HasAPI(UsdSkel.BindingAPI):
        return "USD does not animate it, as it lacks the schema SkelBindingAPI; apply it"
    return "UsdSkel does not bind it to its skeleton, so that it stays still; correct the binding"


class RestPose:
    """The skeletons of a SkelRoot at rest; meshes without one have only their transforms."""

    def __init__(self, root: UsdSkel.Root, ours: FloatArray) -> None:
        self._ours = ours
        self._bindings = skel_bindings(UsdSkel.Cache(), root) if root else {}
        self._transforms = rest_transforms(root.GetPrim()) if root else None

    def place(self, prim: Usd.Prim, local: FloatArray) -> PlacedMesh:
        """Return the points of a mesh skinned at rest, as in UsdSkel."""
        transforms = self._transforms or rest_transforms(prim)
        query, target = self._bindings.get(str(prim.GetPath()), (None, None))
        if query and target and target.HasJointInfluences():
            skinned = _skin_at_rest(query, target, local)
            if skinned is not None:
                world = column_matrix(transforms.GetLocalToWorldTransform(query.GetPrim()))
                linear = self._ours @ world[:3, :3] @ skinned.linear
                return PlacedMesh(transform_points(world, skinned.points) @ self._ours.T, linear)
        world = column_matrix(transforms.GetLocalToWorldTransform(prim))
        return PlacedMesh(transform_points(world, local) @ self._ours.T, self._ours @ world[:3, :3])


def _skin_at_rest(
    query: UsdSkel.SkeletonQuery, target: UsdSkel.SkinningQuery, local: FloatArray
) -> PlacedMesh | None:
    """Skin points in skeleton space at the rest pose; None if the binding is incomplete."""
    rest = query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), atRest=True)
    bind = query.GetJointWorldBindTransforms()
    if not rest or not bind or len(rest) != len(bind):
        return None
    # In the skeleton's order; `ComputeSkinnedPoints` maps them to the mesh's own ``skel:joints``.
    skinning = Vt.Matrix4dArray([b.GetInverse() * r for b, r in zip(bind, rest, strict=True)])

    # Linear blend skinning is affine in each point: its linear part has as columns the differences
    # of a unit step along each axis. Steps of the mesh's size reduce rounding in float32.
    size = max(float(np.ptp(local, axis=0).max()), 1e-6) if len(local) else 1.0
    skinned = []
    for step in (np.zeros(3), *(size * np.eye(3))):
        moved = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(local + step, dtype=np.float32))
        if not target.ComputeSkinnedPoints(skinning, moved, Usd.TimeCode.Default()):
            return None
        skinned.append(np.array(moved, dtype=np.float64))
    placed, *stepped = skinned
    linear = np.stack([(each - placed) / size for each in stepped], axis=-1)
    if len(linear) and np.allclose(linear, linear[0], atol=1e-6):
        exact = np.round(linear.mean(axis=0), 6)
        if np.array_equal(exact, np.eye(3)):
            return PlacedMesh(placed, np.eye(3))
    return PlacedMesh(placed, linear)


_REACH_SHARE = 0.05
"""[of a face's diagonal] Largest distance of a place from its surface: 12 mm on a human face, on
which markers are 6 mm high."""


@dataclass(frozen=True)
class BoundSurface:
    """A surface at rest, to which markers are bound."""

    file: Path
    mesh: RigMesh
    """In millimetres, Y up."""

    @property
    def path(self) -> str:
        """Prim path of the mesh; of the rig, if all of its meshes are one surface."""
        return self.mesh.path

    @property
    def hash(self) -> str:
        """Hash of the surface's points and faces at rest."""
        total = hashlib.sha256()
        total.update(np.ascontiguousarray(self.mesh.points, dtype="<f4").tobytes())
        for indices in (self.mesh.face_counts, self.mesh.face_indices):
            total.update(np.ascontiguousarray(indices, dtype="<i4").tobytes())
        return total.hexdigest()

    @property
    def reach_mm(self) -> float:
        """Largest distance of a place from the surface [mm].

        Relative to the size of the part that shapes move, if there are any, as a rig may have a
        body.
        """
        moved = [key.points for shape in self.mesh.shapes for key in shape.keys]
        points = self.mesh.points
        if moved:
            points = points[np.unique(np.concatenate(moved))]
        return _REACH_SHARE * float(np.linalg.norm(np.ptp(points, axis=0)))


def rig_surfaces(rig: Rig) -> tuple[BoundSurface, ...]:
    """Return all meshes of a rig as one surface, then each of them."""
    places = list(zip(rig.meshes, point_slices(rig.meshes), strict=True))
    shapes = [
        replace(shape, keys=tuple(replace(k, points=k.points + own.start) for k in shape.keys))
        for mesh, own in places
        for shape in mesh.shapes
    ]
    whole = RigMesh(
        path=rig.prim,
        points=np.concatenate([mesh.points for mesh in rig.meshes]),
        face_counts=np.concatenate([mesh.face_counts for mesh in rig.meshes]),
        face_indices=np.concatenate([mesh.face_indices + own.start for mesh, own in places]),
        shapes=tuple(shapes),
    )
    return tuple(BoundSurface(rig.file, mesh) for mesh in (whole, *rig.meshes))


@dataclass(frozen=True)
class FaceMesh(BoundSurface):
    """A mesh to deform, at rest, without its shapes."""

    local: FloatArray
    """(points, 3): its points in the file."""
    linear: FloatArray
    """(3, 3) or (points, 3, 3): from displacements in the mesh's space to ours [mm]."""
    world: FloatArray
    """(4, 4): its transform in its stage, for column vectors and in the stage's unit."""
    normals: str = ""
    """Interpolation of authored normals: ``'vertex'``, ``'faceVarying'``, ``'other'`` or, without
    any, ``''``."""
    normals_attribute: str = "normals"
    """``'normals'`` or ``'primvars:normals'``."""
    authored_normals: FloatArray | None = None
    """(n, 3): per point or per corner of a face, in the file."""
    others: tuple[str, ...] = ()
    """Paths of the file's other meshes, which are not deformed."""
    root: str | None = None
    """Path of its SkelRoot, if it has one."""

    def to_mesh_space(self, moved_mm: FloatArray) -> FloatArray:
        """Return displacements in the mesh's space from those in millimetres: (..., points, 3)."""
        inverse = np.linalg.inv(self.linear)
        if inverse.ndim == 2:
            return np.asarray(moved_mm @ inverse.T)
        return np.asarray(np.einsum("nij,...nj->...ni", inverse, moved_mm))


@refusing_wrong_types
def read_face_mesh(path: Path, *, prim: str | None = None) -> FaceMesh:
    """Read the mesh that is to be deformed.

    Parameters
    ----------
    path : Path
        Any USD file with a polygon mesh.
    prim : str, optional
        The mesh, or a prim with only one mesh below it, if the file has several.
    """
    stage = open_stage(path)
    chosen, others = _find_mesh(stage, path, prim)
    where = f"{path} <{chosen.GetPath()}>"
    check_not_instanced(path, chosen)
    _refuse_changing_topology(UsdGeom.Mesh(chosen), where)
    root = UsdSkel.Root.Find(chosen)
    rest = RestPose(root, stage_to_ours(stage))
    mesh, local, placed = read_geometry(chosen, rest, where)
    corners = len(mesh.face_indices)
    if not (mesh.face_counts >= 3).any():
        raise InputError(
            f"{where}: has {len(local)} points and no faces; distances on a surface need one: "
            "mesh the points first"
        )
    kind, attribute, authored = authored_normals(UsdGeom.Mesh(chosen), len(local), corners)
    return FaceMesh(
        file=path,
        mesh=mesh,
        local=local,
        linear=placed.linear,
        world=column_matrix(rest_transforms(chosen).GetLocalToWorldTransform(chosen)),
        normals=kind,
        normals_attribute=attribute,
        authored_normals=authored,
        others=others,
        root=str(root.GetPath()) if root else None,
    )


def at_rest(attribute: Usd.Attribute) -> Any:
    """Return the default value, else the first sample."""
    value = attribute.Get()
    return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value


def _find_mesh(stage: Usd.Stage, path: Path, prim: str | None) -> tuple[Usd.Prim, tuple[str, ...]]:
    top = prim_or_root(stage, prim, file=path, option="--mesh-prim")
    every = prims_below(stage.GetPseudoRoot(), UsdGeom.Mesh)
    found = [each for each in every if each.GetPath().HasPrefix(top.GetPath())]
    if not found:
        raise InputError(f"{path} <{top.GetPath()}>: holds no mesh; is it the face's file?")
    if len(found) > 1:
        sizes = {each: len(at_rest(UsdGeom.Mesh(each).GetPointsAttr()) or ()) for each in found}
        named = sorted(found, key=lambda each: -sizes[each])
        paths = first_few(f"<{each.GetPath()}> ({sizes[each]} points)" for each in named)
        raise InputError(
            f"{path}: holds {len(found)} meshes, {paths}; name the "
            "one with the face's skin with --mesh-prim, or join them if they share it"
        )
    others = tuple(str(each.GetPath()) for each in every if each != found[0])
    return found[0], others


def _refuse_changing_topology(geometry: UsdGeom.Mesh, where: str) -> None:
    for attribute in (geometry.GetFaceVertexCountsAttr(), geometry.GetFaceVertexIndicesAttr()):
        times = attribute.GetTimeSamples()
        first = attribute.Get(times[0]) if times else None
        for time in times[1:]:
            if attribute.Get(time) != first:
                raise InputError(
                    f"{where}: its topology changes over time ({attribute.GetName()} at time code "
                    f"{time:g}); markers are bound to faces that stay: give one frame of it"
                )
    points = geometry.GetPointsAttr()
    sizes = {len(points.Get(time) or ()) for time in points.GetTimeSamples()}
    if len(sizes) > 1:
        raise InputError(
            f"{where}: its number of points changes over time ({min(sizes)} to {max(sizes)}); "
            "markers are bound to faces that stay: give one frame of it"
        )


def read_geometry(
    prim: Usd.Prim, rest: RestPose, where: str
) -> tuple[RigMesh, FloatArray, PlacedMesh]:
    """Read a mesh at rest without shapes and materials, its points in the file, and its place.

    Faces of points that are not there, and points that are not finite, are refused.
    """
    geometry = UsdGeom.Mesh(prim)
    local = np.array(at_rest(geometry.GetPointsAttr()) or [], np.float64).reshape(-1, 3)
    counts = np.array(at_rest(geometry.GetFaceVertexCountsAttr()) or [], np.int64)
    indices = np.array(at_rest(geometry.GetFaceVertexIndicesAttr()) or [], np.int64)
    fits = counts.min(initial=0) >= 0 and counts.sum() == len(indices)
    if not fits or indices.min(initial=0) < 0 or indices.max(initial=-1) >= len(local):
        raise InputError(f"{where}: its faces name points that are not there; repair the mesh")
    bad = np.flatnonzero(~np.isfinite(local).all(axis=1))
    if len(bad):
        raise InputError(
            f"{where}: points hold NaN or infinity ({len(bad)}, the first is point {bad[0]}); "
            "repair the mesh"
        )
    placed = rest.place(prim, local)
    left_handed = geometry.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    mesh = RigMesh(
        path=str(prim.GetPath()),
        points=placed.points,
        face_counts=counts,
        face_indices=indices,
        colors=read_colors(geometry, len(local), indices),
        subdivision=str(geometry.GetSubdivisionSchemeAttr().Get()),
        inside_out=bool(left_handed != (np.median(np.linalg.det(placed.linear)) < 0)),
    )
    return mesh, local, placed


def authored_normals(
    geometry: UsdGeom.Mesh, point_count: int, corner_count: int
) -> tuple[str, str, FloatArray | None]:
    """Return interpolation, attribute and values of the authored normals."""
    primvar = UsdGeom.PrimvarsAPI(geometry).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        attribute, interpolation = "primvars:normals", primvar.GetInterpolation()
        values = primvar.ComputeFlattened()
    else:
        attribute, interpolation = "normals", geometry.GetNormalsInterpolation()
        values = at_rest(geometry.GetNormalsAttr())
    if not values:
        return "", attribute, None
    normals = np.array(values, np.float64).reshape(-1, 3)
    if interpolation in ("vertex", "varying") and len(normals) == point_count:
        return "vertex", attribute, normals
    if interpolation == "faceVarying" and len(normals) == corner_count:
        return "faceVarying", attribute, normals
    return "other", attribute, None


def read_colors(mesh: UsdGeom.Mesh, point_count: int, indices: IntArray) -> FloatArray | None:
    """Return linear colours of points; None if the file has them with another interpolation."""
    primvar = mesh.GetDisplayColorPrimvar()
    values = primvar.ComputeFlattened() if primvar and primvar.HasAuthoredValue() else None
    if values is None:
        return None
    colors = np.array(values, dtype=np.float64).reshape(-1, 3)
    if len(colors) == 1:
        return np.repeat(colors, point_count, axis=0)
    if len(colors) == point_count:
        return colors
    if len(colors) == len(indices):  # one per face corner: a point takes their mean
        sums = np.zeros((point_count, 3))
        np.add.at(sums, indices, colors)
        used = np.bincount(indices, minlength=point_count)
        return sums / np.maximum(used, 1)[:, None]
    return None
