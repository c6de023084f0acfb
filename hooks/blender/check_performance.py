"""Blender: check that a performance opens with animated shapes.

    blender --background --python check_performance.py -- kitchen.hero.usda

With Blender as a Python module: ``python check_performance.py -- FILE``.

Imports the file and evaluates all shape keys on a sample of frames. The exit code is 0 if shapes
move, 1 if none does, 2 if the file cannot be imported.
"""

import sys

LEAST_FRAMES = 24
"""Number of frames that are sampled at least, if there are as many; at most twice as many are."""

SMALLEST_MOVE = 1e-4
"""Least range of weights that counts as motion."""


def moving_shapes(bpy):
    """Return the range of weights of each moving shape key, by ``mesh.shape``.

    Parameters
    ----------
    bpy : module
        Blender's.
    """
    scene = bpy.context.scene
    first, last = scene.frame_start, scene.frame_end
    step = max(1, (last - first) // LEAST_FRAMES)
    seen = {}
    for frame in [*range(first, last, step), last]:
        scene.frame_set(frame)
        for mesh in bpy.data.meshes:
            # the first key is the rest
            for key in mesh.shape_keys.key_blocks[1:] if mesh.shape_keys else ():
                low, high = seen.get(f"{mesh.name}.{key.name}", (key.value, key.value))
                span = (min(low, key.value), max(high, key.value))
                seen[f"{mesh.name}.{key.name}"] = span
    return {name: high - low for name, (low, high) in seen.items() if high - low > SMALLEST_MOVE}


def check(bpy, file):
    """Import a file into an empty scene and report its moving shapes; return the exit code."""
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
            f"{file}: opens without a mesh: a layer of weights has no character; give the "
            "performance, a published version or the output of `usdface package`\n"
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
