"""An animator's edits per shape, in a layer stronger than the weights, which `map` does not write.

``face:edit:SHAPE`` is added to the weight; ``face:override:SHAPE`` replaces it by the share
``face:mask:SHAPE`` (by default 1 over the samples of the override). ``face:beneath:SHAPE`` is the
solved weight at the time of the edit, by which changes of the solve are detected.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdSkel

from usdface.core.arrays import Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance, hash_files
from usdface.core.rates import check_frame_span
from usdface.core.rig_logic import Combination, logic_of
from usdface.core.sidecars import edits_path
from usdface.core.text import first_few
from usdface.numerics.motion.key_reduction import (
    EditCurve,
    apply_edit,
    needed_samples,
    no_edit,
    reduce_keys,
)
from usdface.usdio.authoring import (
    author_timing,
    check_not_instanced,
    key_times,
    prim_paths_in,
    retime_layer,
    top_path,
)
from usdface.usdio.layers import new_layers, open_layer, sublayer_asset, usd_errors_as_input_errors
from usdface.usdio.performance.weights_layer import VARIANT_SET
from usdface.usdio.units import author_units

_OFFSET = "face:edit:"
OVERRIDE = "face:override:"
MASK = "face:mask:"
EDITED_SOLVE = "face:beneath:"
PREFIXES = (_OFFSET, OVERRIDE, MASK, EDITED_SOLVE)

EDITED_SOLVE_TOLERANCE = 1e-3
"""Tolerance of the stored solve below an edit, which is used in comparisons alone."""


@dataclass(frozen=True)
class ShapeEdit:
    """Edit of one shape over a range of frames."""

    curve: EditCurve
    solve_when_edited: FloatArray
    """(frames,): the solved weight when the edit was made; NaN if unknown."""

    def during(self, part: slice) -> "ShapeEdit":
        """Return the edit over a part of its frames."""
        curve = self.curve
        cut = EditCurve(curve.offset[part], curve.override[part], curve.mask[part])
        return ShapeEdit(cut, self.solve_when_edited[part])


def read_edits(animation: Usd.Prim, frames: IntArray) -> dict[str, ShapeEdit]:
    """Read the composed edits of an animation at ascending frame numbers."""
    attributes: dict[str, dict[str, Usd.Attribute]] = {}
    for attribute in animation.GetAuthoredPropertiesInNamespace("face"):
        for prefix in PREFIXES:
            if attribute.GetName().startswith(prefix):
                shape = attribute.GetDisplayName() or attribute.GetName().removeprefix(prefix)
                attributes.setdefault(shape, {})[prefix] = attribute
    edits = {shape: _read_shape(parts, frames) for shape, parts in attributes.items()}
    return {shape: edit for shape, edit in edits.items() if edit.curve.active.any()}


def _read_shape(parts: Mapping[str, Usd.Attribute], frames: IntArray) -> ShapeEdit:
    offset, override, mask, solve = (_read_curve(parts.get(kind), frames) for kind in PREFIXES)
    nothing, unknown = no_edit(len(frames)), np.full(len(frames), np.nan)
    if offset is None:
        offset = nothing.offset
    if override is None:
        override, mask = nothing.override, nothing.mask
    elif mask is None:
        mask = _sampled(parts[OVERRIDE], frames).astype(np.float64)
    if solve is not None:
        solve = np.where(_sampled(parts[EDITED_SOLVE], frames), solve, np.nan)
    hidden = _blocked(parts.get(OVERRIDE), frames) | _blocked(parts.get(MASK), frames)
    curve = EditCurve(
        np.where(_blocked(parts.get(_OFFSET), frames), 0.0, offset),
        override,
        np.where(hidden, 0.0, np.clip(mask, 0.0, 1.0)),
    )
    return ShapeEdit(curve, unknown if solve is None else solve)


def _read_curve(attribute: Usd.Attribute | None, frames: IntArray) -> FloatArray | None:
    """Return an attribute's values at frames, interpolated linearly and held at the ends."""
    if attribute is None:
        return None
    times = key_times(attribute)
    samples = [(time, attribute.Get(time)) for time in times] or [(0.0, attribute.Get())]
    first = next((value for _, value in samples if value is not None), None)
    if first is None:
        return None
    for index, (time, value) in enumerate(samples):
        if value is None:  # a blocked sample: hold the previous value
            samples[index] = (time, samples[index - 1][1] if index else first)
    try:
        values = np.array([float(value) for _, value in samples])
    except (TypeError, ValueError) as error:
        raise InputError(f"{_where(attribute)}: is no number; make it a float") from error
    if not np.isfinite(values).all():
        time = samples[int(np.argmin(np.isfinite(values)))][0]
        raise InputError(f"{_where(attribute)} time code {time:g}: is not finite; correct the key")
    return np.asarray(np.interp(frames, [time for time, _ in samples], values))


def _blocked(attribute: Usd.Attribute | None, frames: IntArray) -> np.ndarray:
    """Return the frames from a blocked sample to the next that is not."""
    if attribute is None:
        return np.zeros(len(frames), dtype=bool)
    times = key_times(attribute)
    blocks = np.array([attribute.Get(time) is None for time in times])
    if not blocks.any():
        return np.zeros(len(frames), dtype=bool)
    latest: np.ndarray = blocks[np.maximum(np.searchsorted(times, frames, side="right") - 1, 0)]
    return latest


def _sampled(attribute: Usd.Attribute, frames: IntArray) -> np.ndarray:
    """Return the frames within an attribute's samples; all, if it is constant."""
    times = key_times(attribute)
    if not times:
        return np.ones(len(frames), dtype=bool)
    within: np.ndarray = (frames >= times[0]) & (frames <= times[-1])
    return within


def _where(attribute: Usd.Attribute) -> str:
    spec = attribute.GetPropertyStack(Usd.TimeCode.Default())
    return f"{spec[0].layer.realPath if spec else ''} <{attribute.GetPath()}>"


def edited_frames(animation: Usd.Prim) -> tuple[int, int] | None:
    """Return the first and the last frame of the samples of edits; None without edits."""
    times = [
        time
        for attribute in animation.GetAuthoredPropertiesInNamespace("face")
        if attribute.GetName().startswith(PREFIXES)
        for time in key_times(attribute)
    ]
    if not times:
        return None
    check_frame_span(f"<{animation.GetPath()}> edits", min(times), max(times), samples=None)
    return int(np.floor(min(times))), int(np.ceil(max(times)))


def edits_elsewhere(performance: Path, animation: Usd.Prim) -> list[str]:
    """Return the prims with edits other than the animation, which have no effect."""
    layer = open_layer(edits_path(performance))
    return [
        str(path)
        for path in prim_paths_in(layer)
        if path != animation.GetPath()
        and any(
            name.startswith((_OFFSET, OVERRIDE))
            for name in layer.GetPrimAtPath(path).attributes.keys()
        )
    ]


def edited_weights(
    names: Iterable[str],
    solved: FloatArray | Float32Array,
    edits: Mapping[str, ShapeEdit],
    *,
    ranges: Mapping[str, Sequence[float]] | None = None,
    combinations: Sequence[Combination] = (),
) -> FloatArray:
    """Return weights with edits applied, (frames, shapes) as `solved`.

    Edited frames are limited to `ranges`. Combinations follow the edits of their drivers, and may
    be edited in addition.
    """
    edited, names = np.array(solved, dtype=np.float64), tuple(names)
    driven = {each.shape for each in combinations}

    def apply(those: Iterable[str]) -> None:
        for name in those:
            column, curve = names.index(name), edits[name].curve
            values = apply_edit(edited[:, column], curve)
            if ranges is not None and name in ranges:
                low, high = ranges[name]
                values = np.clip(values, low, high)
            edited[curve.active, column] = values[curve.active]

    present = [name for name in names if name in edits]
    apply(name for name in present if name not in driven)
    logic = logic_of(names, combinations)
    if logic is not None and not driven.issuperset(present):
        follow = logic.complete(edited, names) - logic.complete(np.asarray(solved, float), names)
        for column, each in zip(range(-len(combinations), 0), combinations, strict=True):
            if each.shape in names:
                edited[:, names.index(each.shape)] += follow[:, column]
    apply(name for name in present if name in driven)
    return edited


def write_edits(
    performance: Path,
    animation: Usd.Prim,
    edits: Mapping[str, ShapeEdit],
    frames: IntArray,
    *,
    stamp: str | None = None,
    provenance: Provenance,
) -> Path:
    """Write edits into NAME.edits.usda, and make it the strongest sublayer of NAME.usda.

    Edits of other shapes and prims are preserved, and the layer's offset. `InputError` if a layer
    cannot be written, two shapes have the same attribute name, a stronger layer has edits of a
    shape, or another process changed the edits since.

    Parameters
    ----------
    performance : Path
        The layer to open.
    edits : mapping of str to ShapeEdit
        By shape; one that is active nowhere is removed.
    frames : (n,) int array
        Consecutive frame numbers of the curves.
    stamp : str, optional
        `edits_stamp` before the previous edits were read.
    """
    check_not_instanced(performance, animation)
    _check_one_take(performance, animation)
    path = edits_path(performance)
    top = animation.GetStage().GetRootLayer()
    names = UsdSkel.Animation(animation).GetBlendShapesAttr().Get() or ()
    tokens = _attribute_names([*map(str, names), *edits])
    elsewhere = {shape: _edited_elsewhere(animation, path, tokens[shape]) for shape in edits}
    root = open_layer(performance)
    asset = sublayer_asset(root, path, performance)
    below, back = list(root.subLayerPaths), Sdf.LayerOffset()  # to the layer's times
    made: dict[Path, Provenance | None] = {path: provenance}
    if asset in below:
        back = root.subLayerOffsets[below.index(asset)].GetInverse()
    else:
        made[performance] = None
    with (
        usd_errors_as_input_errors(path, "writing it"),  # open stages compose again
        new_layers(made) as (layer, *above),
    ):
        if stamp is not None and edits_stamp(performance) != stamp:
            raise InputError(
                f"{path}: another process changed it since it was read; nothing was written: give "
                "the command again"
            )
        if path.is_file():
            layer.TransferContent(open_layer(path))
            retime_layer(layer, top.timeCodesPerSecond)
        else:
            author_units(layer, like=performance)
            layer.defaultPrim = top_path(animation.GetPath()).name
        author_timing(
            layer,
            rate=top.timeCodesPerSecond,
            first=back * min(top.startTimeCode, int(frames[0])),
            last=back * max(top.endTimeCode, int(frames[-1])),
        )
        times = back.offset + back.scale * frames
        prim = Sdf.CreatePrimInLayer(layer, animation.GetPath())
        for shape, edit in edits.items():
            _write_shape(prim, shape, tokens[shape], edit, times, weaker=elsewhere[shape])
        for opened in above:
            opened.TransferContent(open_layer(performance))
            if asset not in list(opened.subLayerPaths):
                opened.subLayerPaths.insert(0, asset)
    return path


def _check_one_take(performance: Path, animation: Usd.Prim) -> None:
    """Refuse an asset of several takes: a layer above its variants changes all of them."""
    layer = open_layer(performance)
    for path in animation.GetPath().GetPrefixes():
        prim = layer.GetPrimAtPath(path)
        takes = prim.variantSets.get(VARIANT_SET) if prim else None
        if takes is not None and len(takes.variants) > 1:
            raise InputError(
                f"{performance}: its takes {first_few(takes.variants.keys())} are variants, and an "
                "edit above them would change all; edit the performance that the variant references"
            )


def edits_stamp(performance: Path) -> str:
    """Return a hash of a performance's edits; empty without any."""
    path = edits_path(performance)
    return hash_files([path]) if path.is_file() else ""


def _attribute_names(shapes: Iterable[str]) -> dict[str, str]:
    """Return a valid attribute name for each shape."""
    names: dict[str, str] = {}
    owner: dict[str, str] = {}
    for shape in shapes:
        valid = Sdf.Path.IsValidNamespacedIdentifier(shape)
        name = shape if valid else ":".join(map(Tf.MakeValidIdentifier, shape.split(":")))
        if owner.setdefault(name, shape) != shape:
            raise InputError(
                f"shapes {owner[name]!r} and {shape!r} would share the attribute {_OFFSET}{name}; "
                "rename one on the rig"
            )
        names[shape] = name
    return names


def _edited_elsewhere(animation: Usd.Prim, path: Path, name: str) -> frozenset[str]:
    """Return the kinds of edits of a shape in layers weaker than `path`."""
    local = animation.GetStage().GetLayerStack(includeSessionLayers=False)
    files = [Path(layer.realPath).resolve() for layer in local]
    own = path.resolve()
    strength = files.index(own) if own in files else 1  # it will be the first sublayer
    kinds = set[str]()
    for prefix in (_OFFSET, OVERRIDE, MASK):
        attribute = animation.GetAttribute(prefix + name)
        for spec in attribute.GetPropertyStack(Usd.TimeCode.Default()) if attribute else ():
            if spec.layer in local[:strength]:
                raise InputError(
                    f"{spec.layer.realPath} <{spec.path}>: is stronger than {path}, where edits "
                    "are written, so that no change would show; take it out there, or move it to "
                    "that layer"
                )
            if Path(spec.layer.realPath).resolve() != own:
                kinds.add(prefix)
    return frozenset(kinds)


def _write_shape(
    prim: Sdf.PrimSpec,
    shape: str,
    name: str,
    edit: ShapeEdit,
    times: FloatArray,
    *,
    weaker: frozenset[str],
) -> None:
    """Write all attributes of a shape.

    Attributes without effect are omitted, unless weaker layers have these kinds (`weaker`).
    """
    curve = edit.curve
    active = np.flatnonzero(curve.active)
    overridden = curve.mask > 0
    offset = curve.offset if curve.offset.any() or _OFFSET in weaker else None
    _write_curve(prim, _OFFSET + name, shape, times, offset)
    held = None
    if overridden.any():
        held = np.interp(times, times[overridden], curve.override[overridden])
    _write_curve(prim, OVERRIDE + name, shape, times, held)
    mask = curve.mask if overridden.any() or OVERRIDE in weaker else None
    _write_curve(prim, MASK + name, shape, times, mask)
    if not len(active):
        _write_curve(prim, EDITED_SOLVE + name, shape, times, None)
        return
    known = np.flatnonzero(curve.active & np.isfinite(edit.solve_when_edited))
    if not len(known):
        return
    part = slice(int(known[0]), int(known[-1]) + 1)
    filled = np.interp(np.arange(part.start, part.stop), known, edit.solve_when_edited[known])
    keys = reduce_keys(filled[:, None], EDITED_SOLVE_TOLERANCE)
    _write_samples(prim, EDITED_SOLVE + name, shape, times[part][keys], filled[keys])


def _write_curve(
    prim: Sdf.PrimSpec, name: str, shape: str, times: FloatArray, values: FloatArray | None
) -> None:
    if values is None:
        if name in prim.attributes:
            prim.RemoveProperty(prim.attributes[name])
        return
    rounded = values.astype(np.float32).astype(np.float64)
    needed = needed_samples(rounded)
    _write_samples(prim, name, shape, times[needed], rounded[needed])


def _write_samples(
    prim: Sdf.PrimSpec, name: str, shape: str, times: FloatArray, values: FloatArray
) -> None:
    if name in prim.attributes:
        prim.RemoveProperty(prim.attributes[name])
    attribute = Sdf.AttributeSpec(prim, name, Sdf.ValueTypeNames.Float)
    attribute.custom = True
    if not name.endswith(f":{shape}"):
        attribute.displayName = shape
    for time, value in zip(times.tolist(), values.tolist(), strict=True):
        prim.layer.SetTimeSample(attribute.path, time, value)
