"""Every reader of USD, by what is read, and the layer of a finished shot that it reads."""

import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

from pxr import Gf, Usd, UsdGeom

from usdface.steps.edits.edit import all_frames
from usdface.steps.edits.validate import validate_layers
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.review.faces import Actor
from usdface.usdio.layers import read_provenance
from usdface.usdio.mapping import read_alpha_keys, read_mapping
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.referenced_files import frame_range_of, referenced_files
from usdface.usdio.references.read import read_pair_notes, read_references
from usdface.usdio.references.weight_layers import read_proposals, read_tuned_pairs
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.retarget.pairs import read_pairs
from usdface.usdio.retarget.retargeting import read_retargeting
from usdface.usdio.retarget.sequences import read_matches, read_sequence
from usdface.usdio.rig.mesh import read_face_mesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.stage_camera import StageCamera
from usdface.usdio.surface.binding import read_binding
from usdface.usdio.take.foreign import read_foreign_take
from usdface.usdio.take.read import read_take

Read = Callable[[Path], object]

READERS: dict[str, tuple[str, str, Read]] = {
    "take": ("shot.take.usda", "shot.take.samples.usdc", read_take),
    "cleaned take": ("shot.clean.take.usda", "shot.clean.take.samples.usdc", read_take),
    "take with video": ("kitchen.take.usda", "kitchen.take.usda", read_take),
    "foreign take": ("shot.take.usda", "shot.take.samples.usdc", read_foreign_take),
    "rig": ("hero.usdc", "hero.usdc", read_rig),
    "rig with joints": ("beast.usda", "beast.usda", read_rig),
    "mesh": ("scan.usdc", "scan.usdc", read_face_mesh),
    "references": ("hero.references.usda", "hero.references.usda", read_references),
    "proposed": ("hero.references.usda", "hero.references.proposed.usda", read_references),
    "tuned": ("hero.references.usda", "hero.references.tuned.usda", read_references),
    "mapping": ("hero.mapping.usdc", "hero.mapping.usdc", read_mapping),
    "performance": ("shot.hero.usda", "shot.hero.usda", read_performance),
    "weights": ("shot.hero.usda", "shot.hero.weights.usdc", read_performance),
    "edits": ("edited.hero.usda", "edited.hero.edits.usda", read_performance),
    "weight table": ("shot.baked.usdc", "shot.baked.usdc", read_weight_table),
    "source": ("shot.usda", "shot.usda", read_source_motion),
    "controls": ("beast.shot.usda", "beast.shot.controls.usdc", read_control_clip),
    "pairs": ("x.pairs.usda", "x.pairs.proposed.usda", read_pairs),
    "retargeting": ("x.retarget.usdc", "x.retarget.usdc", read_retargeting),
    "sequence": ("joy.sequence.usda", "joy.sequence.usda", read_sequence),
    "matches": ("shot.matches.usda", "shot.matches.usda", read_matches),
    "alpha": ("shot.matches.usda", "shot.matches.usda", read_alpha_keys),
    "binding": (
        "scan.binding.usda",
        "scan.binding.proposed.usda",
        lambda path: read_binding(path, read_face_mesh(path.with_name("scan.usdc"))),
    ),
    "posed": ("shot.hero.usda", "shot.hero.usda", Actor),
    "range": ("shot.take.usda", "shot.take.usda", frame_range_of),
    "making": ("shot.hero.usda", "shot.hero.usda", read_provenance),
    "files": ("shot.hero.usda", "shot.hero.usda", referenced_files),
    "notes": (
        "hero.references.usda",
        "hero.references.usda",
        read_pair_notes,
    ),
    "proposals": (
        "hero.references.usda",
        "hero.references.proposed.usda",
        lambda path: read_proposals(
            path.with_name("hero.references.proposed.usda"), read_references(path)
        ),
    ),
    "tuned pairs": (
        "hero.references.usda",
        "hero.references.tuned.usda",
        lambda path: read_tuned_pairs(path.with_name("hero.references.tuned.usda")),
    ),
    "edited frames": (
        "edited.hero.usda",
        "edited.hero.edits.usda",
        lambda path: all_frames(PerformanceReader(path)),
    ),
    "camera": (
        "filmed.usda",
        "filmed.usda",
        lambda path: StageCamera(
            path, "/Camera", read_rig(path.with_name("hero.usdc")), rate=Fraction(120)
        ).at(48),
    ),
}
"""What is read, the layer that is damaged, and the reader."""


def film(path: Path) -> None:
    """Write a shot: a performance, and a camera that moves."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.GetRootLayer().subLayerPaths.append("./shot.hero.usda")
    stage.SetTimeCodesPerSecond(120)
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    place = camera.AddTranslateOp()
    for frame in range(1, 97):
        place.Set(Gf.Vec3d(frame, 160, 60), frame)
    stage.Save()


def end(path: Path) -> None:
    """What a fault in a library does."""
    os._exit(3)


READERS_BY_NAME: dict[str, Read] = {
    **{name: read for name, (_, _, read) in READERS.items()},
    "validate": lambda path: validate_layers((path,)),
    "end": end,
}
