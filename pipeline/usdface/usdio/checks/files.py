"""Checks of files, paths, names of shapes, sides, instances and provenance."""

from collections.abc import Iterator
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, UsdUtils

from usdface.core.arrays import FloatArray
from usdface.core.text import first_few, frame_ranges, repeated
from usdface.usdio.authoring import names_in, read_gaps
from usdface.usdio.checks.curves import pair_sides
from usdface.usdio.checks.fault import Fault, is_recorded, is_solved
from usdface.usdio.performance.weights_layer import UNMATCHED
from usdface.usdio.reached import cannot_be_opened
from usdface.usdio.referenced_files import lost_targets
from usdface.usdio.retarget.controls import attribute_names, attribute_path
from usdface.usdio.rig.mesh import still_meshes

CLEAR_SHARE = 0.2
"""[of the whole displacement] Least difference between the sides of a one-sided shape."""


def check_names(prim: Usd.Prim) -> Iterator[Fault]:
    """Find shapes that no mesh has or that are named twice, and animations without a skeleton."""
    names = names_in(UsdSkel.Animation(prim).GetBlendShapesAttr())
    if not names or is_recorded(prim):
        return
    path = str(prim.GetPath())
    if twice := repeated(names):
        message = f"{first_few(twice)}: named twice; name each shape once"
        yield Fault.error(path, message)
    yield from _unmatched(prim)
    on_meshes, followed = _bound_shapes(prim)
    if not followed:
        message = (
            "no skeleton follows this animation; point skel:animationSource at it, or open the "
            "layer above that references the rig"
        )
        yield Fault.warning(path, message)
    missing = sorted(set(names) - on_meshes)
    if missing and on_meshes:
        yield Fault.error(
            path,
            f"{len(missing)} shapes are on no mesh: {first_few(missing)}; is it this rig's "
            "animation? Map again for the rig, or rename the shapes",
        )
    yield from _still(prim)
    skipped = _skipped_shapes(prim, set(names)) if is_solved(prim) and not missing else {}
    if skipped:
        mesh, shapes = next(iter(skipped.items()))
        yield Fault.warning(
            path,
            f"{len(skipped)} of the meshes that it animates have shapes it does not "
            f"name, such as {first_few(shapes, most=3)} of {mesh}: importers that pair by order "
            "(Maya's) would put curves on wrong shapes. Map or retarget again, which writes all",
        )


def _unmatched(prim: Usd.Prim) -> Iterator[Fault]:
    """Find unmatched shapes of a retargeting, interpolated frames, and weights that are all 0."""
    lost = names_in(prim.GetAttribute(UNMATCHED))
    if lost:
        yield Fault.warning(
            prim.GetPath(),
            f"{len(lost)} shapes of the source move and have no counterpart here: "
            f"{first_few(lost)}; give them counterparts, in a table (`usdface names`, --names) or "
            "in pairs to train on, and retarget again",
        )
    if gaps := read_gaps(prim):
        yield Fault.warning(
            prim.GetPath(),
            f"nothing was captured in {frame_ranges(gaps)}: what is there is interpolated. "
            "Animate it by hand, or take another take",
        )
    if is_solved(prim) and not _moves(prim):
        yield Fault.error(
            prim.GetPath(),
            "nothing ever moves: every weight is 0 at every frame. Look at the source and at the "
            "names that are matched (`usdface names`)",
        )


def _moves(prim: Usd.Prim) -> bool:
    """Whether a solve has a weight, or its joints or attributes move."""
    skel = UsdSkel.Animation(prim)
    weights = skel.GetBlendShapeWeightsAttr()
    times = weights.GetTimeSamples()
    if len(times) < 2 or any(np.any(np.asarray(weights.Get(time))) for time in times):
        return True
    named = [attribute_path(prim.GetParent().GetPath(), name) for name in attribute_names(prim)]
    stage = prim.GetStage()
    others = [stage.GetAttributeAtPath(path) for path in named if path]
    others += [skel.GetRotationsAttr(), skel.GetTranslationsAttr(), skel.GetScalesAttr()]
    return any(len({str(each.Get(time)) for time in times}) > 1 for each in others if each)


def _still(animation: Usd.Prim) -> Iterator[Fault]:
    """Find meshes with BlendShapes that should follow an animation and that USD does not move."""
    stage = animation.GetStage()
    for root in filter(UsdSkel.Root, stage.Traverse(Usd.TraverseInstanceProxies())):
        for path, reason in still_meshes(UsdSkel.Root(root)).items():
            if _followed(UsdSkel.BindingAPI(stage.GetPrimAtPath(path))) == animation.GetPath():
                yield Fault.error(path, reason)


def _followed(mesh: UsdSkel.BindingAPI) -> Sdf.Path | None:
    """Return the animation that a mesh follows."""
    skeleton = mesh.GetInheritedSkeleton()
    source = UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource() if skeleton else None
    return source.GetPath() if source else None


def _skipped_shapes(animation: Usd.Prim, names: set[str]) -> dict[str, list[str]]:
    """Return the shapes of each animated mesh that the animation does not name."""
    skipped: dict[str, list[str]] = {}
    for prim in animation.GetStage().Traverse(Usd.TraverseInstanceProxies()):
        binding = UsdSkel.BindingAPI(prim)
        shapes = names_in(binding.GetBlendShapesAttr())
        if not names.intersection(shapes) or names.issuperset(shapes):
            continue
        if _followed(binding) == animation.GetPath():
            skipped[prim.GetName()] = [shape for shape in shapes if shape not in names]
    return skipped


def check_instances(stage: Usd.Stage) -> Iterator[Fault]:
    """Find opinions below instances, which USD ignores."""
    for prim in stage.Traverse():
        if not prim.IsInstance():
            continue
        ignored = [
            layer.GetDisplayName()
            for layer in stage.GetLayerStack(includeSessionLayers=False)
            if (spec := layer.GetPrimAtPath(prim.GetPath())) is not None and spec.nameChildren
        ]
        if ignored:
            yield Fault.error(
                prim.GetPath(),
                f"is instanceable, and USD ignores what {first_few(ignored)} says below it: "
                "the face would not move. Author instanceable = false on it in the shot",
            )


def _bound_shapes(animation: Usd.Prim) -> tuple[set[str], bool]:
    """Return the shapes on its meshes, and whether a skeleton follows the animation.

    Those of all meshes if none follows it. True as well for an animation of the rig itself that a
    solve replaces.
    """
    of_others, on_meshes = set[str](), set[str]()
    followed = False
    for prim in animation.GetStage().Traverse(Usd.TraverseInstanceProxies()):
        binding = UsdSkel.BindingAPI(prim)
        if shapes := names_in(binding.GetBlendShapesAttr()):
            alone = _followed(binding) in (None, animation.GetPath())
            (on_meshes if alone else of_others).update(shapes)
        if prim.IsA(UsdSkel.Skeleton):
            source = binding.GetInheritedAnimationSource()
            if source:
                replaced = is_solved(source.GetPrim()) and not is_solved(animation)
                followed |= replaced or source.GetPath() == animation.GetPath()
    return on_meshes or of_others, followed


def check_sides(stage: Usd.Stage) -> Iterator[Fault]:
    """Find pairs of shapes whose sides are exchanged, compared with the majority of pairs."""
    for mesh in stage.Traverse():
        binding = UsdSkel.BindingAPI(mesh) if mesh.IsA(UsdGeom.Mesh) else None
        names = names_in(binding.GetBlendShapesAttr()) if binding else ()
        pairs = pair_sides(names)
        if len(pairs) < 3:
            continue
        shares = [*_side_shares(mesh), *[0.0] * len(names)]  # 0 for names without a target
        clear = [
            (names[left], shares[left] - shares[right])
            for left, right in pairs
            if min(abs(shares[left]), abs(shares[right])) > CLEAR_SHARE
            and shares[left] * shares[right] < 0
        ]
        side = np.sign(sum(np.sign(lean) for _, lean in clear))
        flipped = [name for name, lean in clear if side and np.sign(lean) != side]
        if flipped:
            yield Fault.error(
                mesh.GetPath(),
                f"{first_few(flipped)}: left and right are exchanged, compared with the other "
                f"{len(clear) - len(flipped)} pairs of this mesh; rename the shapes on the rig",
            )


def _side_shares(mesh: Usd.Prim) -> list[float]:
    """Return the asymmetry of each shape's displacements: -1 all at -x, 1 all at +x."""
    points = np.asarray(UsdGeom.Mesh(mesh).GetPointsAttr().Get() or [], dtype=np.float64)
    binding = UsdSkel.BindingAPI(mesh)
    out = []
    for target in binding.GetBlendShapeTargetsRel().GetTargets():
        shape = UsdSkel.BlendShape(mesh.GetStage().GetPrimAtPath(target))
        authored = shape.GetOffsetsAttr().Get() if shape else None
        offsets: FloatArray = np.asarray(authored or np.zeros((0, 3)), dtype=np.float64)
        indices = shape.GetPointIndicesAttr().Get() if shape else None
        rows = np.arange(len(offsets)) if indices is None else np.asarray(indices)
        if not len(offsets) or len(rows) != len(offsets) or rows.max(initial=0) >= len(points):
            out.append(0.0)
            continue
        size = np.linalg.norm(offsets, axis=1)
        middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
        side = np.sign(points[rows, 0] - middle)
        out.append(float((size * side).sum() / max(size.sum(), 1e-12)))
    return out


def _layers_of_ours(stage: Usd.Stage) -> list[Sdf.Layer]:
    """Return the layers of a stage that are files; none if we wrote none of them."""
    stack = stage.GetLayerStack(includeSessionLayers=False)
    layers = [each for each in stack if not each.anonymous]
    return layers if any("usdface" in each.customLayerData for each in layers) else []


def check_absolute_paths(stage: Usd.Stage) -> Iterator[Fault]:
    """Find absolute paths in our layers."""
    for layer in _layers_of_ours(stage):
        absolute = [
            asset
            for kind in UsdUtils.ExtractExternalReferences(layer.realPath)
            for asset in kind
            if PurePosixPath(asset).is_absolute() or PureWindowsPath(asset).is_absolute()
        ]
        if absolute:
            yield Fault.warning(
                "/",
                f"{layer.GetDisplayName()} names {first_few(absolute)} by an absolute path: on "
                "another machine it is not there; name it relative to the layer",
            )


def check_missing_files(stage: Usd.Stage) -> Iterator[Fault]:
    """Find missing references and sublayers of our layers."""
    variables = dict(stage.GetRootLayer().expressionVariables)
    for layer in _layers_of_ours(stage):
        missing = [
            asset
            for asset in layer.GetCompositionAssetDependencies()
            if cannot_be_opened(layer, asset, variables)
        ]
        if missing:
            yield Fault.error(
                "/",
                f"{layer.GetDisplayName()} is built from {first_few(missing)}, which cannot be "
                "opened: was it moved? Put it back, or map again with the rig where it is now",
            )


def check_targets(stage: Usd.Stage) -> Iterator[Fault]:
    """Find targets that are lost outside a referenced prim, and animations that are not active."""
    for path, lost in lost_targets(stage).items():
        yield Fault.warning(path, lost)
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        source = UsdSkel.BindingAPI(prim).GetInheritedAnimationSource()
        if prim.IsA(UsdSkel.Skeleton) and source and not source.IsActive():
            yield Fault.error(
                source.GetPath(),
                f"is not active, so that <{prim.GetPath()}>, which follows it, rests: author "
                "active = true on it in this layer",
            )


def check_provenance(stage: Usd.Stage) -> Iterator[Fault]:
    """Find solved animations without provenance."""
    for prim in stage.TraverseAll():
        if not prim.IsA(UsdSkel.Animation) or not is_solved(prim):
            continue
        specs = prim.GetPrimStack()
        if not any("usdface" in spec.layer.customLayerData for spec in specs):
            yield Fault.warning(
                prim.GetPath(),
                "says nothing of the take, the mapping and the versions it was made from, so "
                "nobody can make it again; write it with usdface, or copy "
                'customLayerData["usdface"] with the samples',
            )
