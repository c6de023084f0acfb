"""Every reader of USD against layers that are sound as USD and wrong as what they claim to be.

Something is taken out, emptied, cut short, turned into NaN or into another type, one thing at a
time, anywhere in any layer. A reader then refuses the file, or reads it; nothing else may escape.
"""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pxr import Sdf, Tf, Usd

from tests.damage import Spoil, damage
from tests.faults.conftest import together
from tests.faults.layer_readers import READERS, Read, film
from tests.faults.world import World
from usdface.core.errors import InputError
from usdface.steps.edits.validate import validate_layers
from usdface.usdio.mapping import read_alpha_keys
from usdface.usdio.take.foreign import read_foreign_take

pytestmark = pytest.mark.faults


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
        if written == damaged:  # binary ones are damaged in test_damaged_crates.py
            written.write_bytes(spoil(text))
            check_refused_or_read(opened, read)
    finally:
        damaged.write_bytes(sound)


def test_the_readers_here_read_what_is_sound(subject: tuple[Path, Path, Read]) -> None:
    opened, _, read = subject
    if read is not read_alpha_keys and read is not read_foreign_take:
        read(opened)
    assert Usd.Stage.Open(str(opened))
