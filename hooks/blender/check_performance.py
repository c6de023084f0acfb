"""Blender: does a performance open with its shapes animated.

    blender --background --python check_performance.py -- kitchen.hero.usda

Where Blender is a Python module, ``python check_performance.py -- FILE`` does the same.

Imports the file as an artist would and looks at every shape key on two frames and between. Ends
with 0 if shapes move, with 1 if none does, with 2 if the file cannot be imported.
"""

import sys

LOOKED_AT = 24
"""Frames, spread over the performance."""

SMALLEST_MOVE = 1e-4
"""Weights that change by less than this stand still."""


def moving_shapes(bpy):
    """Return how far each shape key of the scene moves over its frames.

    Parameters
    ----------
    bpy : module
        Blender's own.

    Returns
    -------
    dict of str to float
        Largest weight less smallest, by ``mesh.shape``; shapes that stand still are left out.
    """
    scene = bpy.context.scene
    first, last = scene.frame_start, scene.frame_end
    step = max(1, (last - first) // LOOKED_AT)
    seen = {}
    for frame in [*range(first, last, step), last]:
        scene.frame_set(frame)
        for mesh in bpy.data.meshes:
            keys = (
                mesh.shape_keys.key_blocks[1:] if mesh.shape_keys else ()
            )  # the first is the rest
            for key in keys:
                low, high = seen.get(f"{mesh.name}.{key.name}", (key.value, key.value))
                span = (min(low, key.value), max(high, key.value))
                seen[f"{mesh.name}.{key.name}"] = span
    return {name: high - low for name, (low, high) in seen.items() if high - low > SMALLEST_MOVE}


def check(bpy, file):
    """Import a file into an empty scene and say what moves in it.

    Parameters
    ----------
    bpy : module
    file : str

    Returns
    -------
    int
        The exit code.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        result = bpy.ops.wm.usd_import(filepath=file, set_frame_range=True)
    except RuntimeError as error:
        sys.stderr.write(f"{file}: Blender cannot import it: {error}\n")
        return 2
    if "FINISHED" not in result:
        sys.stderr.write(f"{file}: Blender did not finish importing it\n")
        return 2
    scene = bpy.context.scene
    if not len(bpy.data.meshes):
        sys.stderr.write(
            f"{file}: opens without a mesh: a layer of weights, baked or not, is no character; "
            "give Blender the performance, a published version or what `usdface package` wrote\n"
        )
        return 1
    sys.stdout.write(
        f"{file}: frames {scene.frame_start}-{scene.frame_end}; the scene keeps its own rate, "
        f"{scene.render.fps / scene.render.fps_base:.6g} frames per second: set the take's\n"
    )
    moving = moving_shapes(bpy)
    for name, travel in sorted(moving.items(), key=lambda each: -each[1]):
        sys.stdout.write(f"  {name}: moves by {travel:.3f}\n")
    if not moving:
        sys.stderr.write(f"{file}: opens, but no shape moves\n")
        return 1
    sys.stdout.write(f"{len(moving)} shapes are animated\n")
    return 0


if __name__ == "__main__":
    import bpy

    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if len(arguments) != 1:
        sys.exit("one file, please: blender --background --python check_performance.py -- FILE")
    sys.exit(check(bpy, arguments[0]))
