"""Every reader of USD against layers that are sound as USD and wrong as what they claim to be.

Something is taken out, emptied, cut short, turned into NaN or into another type, one thing at a
time, anywhere in any layer. A reader then refuses the file, or reads it; nothing else may escape.
"""

import contextlib
import shutil
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pxr import Gf, Sdf, Tf, Usd, UsdGeom

from tests.damage import Spoil, damage
from tests.faults.conftest import together
from tests.faults.world import World
from usdface.errors import InputError
from usdface.steps.edit import all_frames
from usdface.steps.source_motion import read_source_motion
from usdface.steps.validate import validate_layers
from usdface.steps.weight_tables import read_weight_table
from usdface.usdio.alpha import read_alpha_keys
from usdface.usdio.binding import read_binding
from usdface.usdio.controls import read_control_clip
from usdface.usdio.foreign_take import read_foreign_take
from usdface.usdio.layers import read_provenance
from usdface.usdio.mapping import read_mapping
from usdface.usdio.mesh import read_face_mesh
from usdface.usdio.pair_names import read_pair_names
from usdface.usdio.pairs import read_pairs
from usdface.usdio.performance import PerformanceReader, read_performance
from usdface.usdio.posed_points import PosedRig
from usdface.usdio.referenced_files import frame_range_of, referenced_files
from usdface.usdio.references import read_references, read_tuned_pairs
from usdface.usdio.retargeting import read_retargeting
from usdface.usdio.rig import read_rig
from usdface.usdio.sequences import read_matches, read_sequence
from usdface.usdio.stage_camera import StageCamera
from usdface.usdio.take import read_take
from usdface.usdio.tuning import read_pair_notes, read_proposals

pytestmark = pytest.mark.faults

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
    "pair names": ("hero.references.usda", "hero.references.proposed.usda", read_pair_names),
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
    "posed": ("shot.hero.usda", "shot.hero.usda", PosedRig),
    "range": ("shot.take.usda", "shot.take.usda", frame_range_of),
    "making": ("shot.hero.usda", "shot.hero.usda", read_provenance),
    "files": ("shot.hero.usda", "shot.hero.usda", referenced_files),
    "notes": (
        "hero.references.usda",
        "hero.references.usda",
        lambda path: read_pair_notes(path, 24),
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
            path,
            "/Camera",
            rig_file=path.with_name("hero.usdc"),
            rig_prim=read_rig(path.with_name("hero.usdc")).prim,
            rate=Fraction(120),
        ).at(48),
    ),
}
"""What is read, the layer that is damaged, and the reader."""


def specs_of(layer: Sdf.Layer) -> Iterator[Sdf.Spec]:
    found: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, found.append)
    for path in sorted(map(str, found)):
        spec = layer.GetObjectAtPath(path)
        if isinstance(spec, Sdf.PrimSpec | Sdf.PropertySpec) and spec != layer.pseudoRoot:
            yield spec


def shortened(value: Any) -> Any:
    return value[: len(value) // 2] if hasattr(value, "__len__") else value


def emptied(value: Any) -> Any:
    return type(value)()


def not_finite(value: Any) -> Any:
    if isinstance(value, str | bool):
        return value
    with contextlib.suppress(TypeError, ValueError):
        array = np.array(value, copy=True)
        if array.dtype.kind == "f":
            array.flat[array.size // 2 : array.size // 2 + 1] = np.nan
            return type(value).FromNumpy(array) if hasattr(value, "FromNumpy") else float("nan")
        if array.dtype.kind in "iu" and array.size:
            array.flat[array.size // 2] = np.iinfo(np.int32).max
            return type(value).FromNumpy(array) if hasattr(value, "FromNumpy") else -(2**31)
    return value


CHANGES = (shortened, emptied, not_finite)
ANOTHER_TYPE = (
    (Sdf.ValueTypeNames.String, "text"),
    (Sdf.ValueTypeNames.Float, float("inf")),
    (Sdf.ValueTypeNames.TokenArray, ["a", "a", ""]),
    (Sdf.ValueTypeNames.Int64, -(2**63)),
)
ROOT_CHANGES = (
    ("timeCodesPerSecond", 0.0),
    ("timeCodesPerSecond", float("nan")),
    ("startTimeCode", 1e18),
    ("endTimeCode", 1e18),
    ("endTimeCode", 1e9),
    ("endTimeCode", 9e6),
    ("endTimeCode", float("nan")),
    ("metersPerUnit", 0.0),
    ("metersPerUnit", float("inf")),
    ("upAxis", "X"),
    ("defaultPrim", "nobody"),
    ("defaultPrim", ""),
    ("customLayerData", {"usdface": {"version": "1", "spec": "[[", "inputs": 3}}),
    ("customLayerData", {"usdface": "text"}),
)
FAR_OFF = (1e9, 9e6, -1e9, 1e18)
"""Time codes that a reader must not count up to."""
KINDS = 10


def spoil_layer(layer: Sdf.Layer, at: float, kind: int, choice: int) -> None:
    """Change one thing of a layer."""
    specs = list(specs_of(layer))
    spec = specs[int(at * len(specs))]
    if kind == 0:
        name, value = ROOT_CHANGES[choice % len(ROOT_CHANGES)]
        layer.pseudoRoot.SetInfo(name, value)
        return
    if isinstance(spec, Sdf.PrimSpec):
        if kind < 4:
            beside = spec.nameParent.nameChildren if spec.nameParent else layer.rootPrims
            del beside[spec.name]
        elif kind < 6:
            spec.typeName = ("Scope", "Mesh", "SkelAnimation", "NoSuchType")[choice % 4]
        elif kind < 8:
            spec.SetInfo("apiSchemas", Sdf.TokenListOp.CreateExplicit([]))
        else:
            spec.SetInfo("active", False)
        return
    if kind == 1 or isinstance(spec, Sdf.RelationshipSpec):
        spec.owner.RemoveProperty(spec)
    elif kind == 2:
        owner, name = spec.owner, spec.name
        owner.RemoveProperty(spec)
        named, value = ANOTHER_TYPE[choice % len(ANOTHER_TYPE)]
        Sdf.AttributeSpec(owner, name, named).default = value
    else:
        change = CHANGES[choice % len(CHANGES)]
        times = layer.ListTimeSamplesForPath(spec.path)
        if times and kind < 7:
            time = times[int(at * 997) % len(times)]
            value = change(layer.QueryTimeSample(spec.path, time))
            with contextlib.suppress(Tf.ErrorException):  # what USD refuses no layer can hold
                layer.SetTimeSample(spec.path, time, value)
        elif times and kind == 9:
            value = layer.QueryTimeSample(spec.path, times[0])
            layer.SetTimeSample(spec.path, FAR_OFF[choice % len(FAR_OFF)], value)
        elif times and kind == 7:
            layer.EraseTimeSample(spec.path, times[len(times) // 2])
        elif spec.HasDefaultValue():
            with contextlib.suppress(
                Tf.ErrorException, TypeError
            ):  # what USD refuses no layer can hold
                spec.default = change(spec.default)


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


@pytest.fixture(scope="module", params=together(READERS))
def subject(
    request: pytest.FixtureRequest, world: World, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, Read]:
    opened, damaged, read = READERS[request.param]
    folder = tmp_path_factory.mktemp("damaged") / "layers"
    shutil.copytree(world.folder, folder, ignore=shutil.ignore_patterns("*.c3d", "*.mov", "*.mp4"))
    film(folder / "filmed.usda")
    return folder / opened, folder / damaged, read


AS_DEEP_AS_USD_BEARS = [b"(" * 200, b"[" * 200, b'{"a":' * 200]
"""Its parser takes minutes for brackets that are twenty thousand deep: see docs/security.md."""

FUZZ = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=(Phase.explicit, Phase.generate),  # one thing is wrong: there is little to shrink
)


def check_refused_or_read(path: Path, read: Read) -> None:
    with contextlib.suppress(InputError):
        read(path)


@FUZZ
@given(
    at=st.floats(0, 1, exclude_max=True),
    kind=st.integers(0, KINDS - 1),
    choice=st.integers(0, 12),
)
def test_a_layer_with_one_thing_wrong_is_read_or_refused(
    subject: tuple[Path, Path, Read], at: float, kind: int, choice: int
) -> None:
    opened, damaged, read = subject
    sound = damaged.read_bytes()
    layer = Sdf.Layer.OpenAsAnonymous(str(damaged))
    try:
        spoil_layer(layer, at, kind, choice)
        layer.Export(str(damaged))
        check_refused_or_read(opened, read)
        check_refused_or_read(opened, lambda path: validate_layers((path,)))
    finally:
        damaged.write_bytes(sound)


@FUZZ
@given(spoil=damage(AS_DEEP_AS_USD_BEARS))
def test_text_that_is_broken_is_read_or_refused(
    subject: tuple[Path, Path, Read], spoil: Spoil
) -> None:
    opened, damaged, read = subject
    sound = damaged.read_bytes()
    text = Sdf.Layer.OpenAsAnonymous(str(damaged)).ExportToString().encode()
    written = damaged.with_suffix(".usda")
    try:
        if written == damaged:  # a crate that is damaged may end USD itself: see docs/security.md
            written.write_bytes(spoil(text))
            check_refused_or_read(opened, read)
    finally:
        damaged.write_bytes(sound)


def test_the_readers_here_read_what_is_sound(subject: tuple[Path, Path, Read]) -> None:
    opened, _, read = subject
    if read is not read_alpha_keys and read is not read_foreign_take:
        read(opened)
    assert Usd.Stage.Open(str(opened))
