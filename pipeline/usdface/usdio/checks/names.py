"""Shapes by name: on a mesh, once each, followed by a skeleton."""

from collections import Counter

from pxr import Usd, UsdSkel

from usdface.usdio.checks.fault import Fault, is_recorded, some


def check_names(prim: Usd.Prim) -> list[Fault]:
    """Find shapes that no mesh has or that are named twice, and animations nobody follows."""
    names = list(map(str, UsdSkel.Animation(prim).GetBlendShapesAttr().Get() or []))
    if not names or is_recorded(prim):
        return []
    path = str(prim.GetPath())
    found = []
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        message = f"{some(twice)}: named twice; name each shape once"
        found.append(Fault("error", path, message))
    on_meshes, followed = _who_follows(prim)
    if not followed:
        message = (
            "no skeleton follows this animation; point skel:animationSource at it, or open the "
            "layer above that references the rig"
        )
        found.append(Fault("warning", path, message))
    missing = sorted(set(names) - on_meshes)
    if missing and on_meshes:
        found.append(
            Fault(
                "error",
                path,
                f"{len(missing)} shapes are on no mesh: {some(missing)}; is it this rig's "
                "animation? Map again for the rig, or rename the shapes",
            )
        )
    return found


def check_instances(stage: Usd.Stage) -> list[Fault]:
    """Find what layers say below an instance: USD ignores it, so no weight would arrive."""
    found = []
    for prim in stage.Traverse():
        if not prim.IsInstance():
            continue
        ignored = [
            layer.GetDisplayName()
            for layer in stage.GetLayerStack(includeSessionLayers=False)
            if (spec := layer.GetPrimAtPath(prim.GetPath())) is not None and spec.nameChildren
        ]
        if ignored:
            found.append(
                Fault(
                    "error",
                    str(prim.GetPath()),
                    f"is instanceable, and USD ignores what {some(ignored)} says below it: the "
                    "face would not move. Author instanceable = false on it in the shot",
                )
            )
    return found


def _who_follows(animation: Usd.Prim) -> tuple[set[str], bool]:
    """Return the shapes on the stage's meshes, and whether a skeleton follows the animation."""
    on_meshes: set[str] = set()
    followed = False
    for prim in animation.GetStage().Traverse():
        binding = UsdSkel.BindingAPI(prim)
        on_meshes.update(map(str, binding.GetBlendShapesAttr().Get() or []))
        if prim.IsA(UsdSkel.Skeleton):
            source = binding.GetInheritedAnimationSource()
            followed |= bool(source) and source.GetPath() == animation.GetPath()
    return on_meshes, followed
