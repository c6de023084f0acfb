"""Writing of performances: top layers over weights, packages, and assets of several takes."""

import contextlib
import struct
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from pxr import Kind, Sdf, Usd, UsdUtils

from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import check_not_written_since, replacing_group
from usdface.core.side_files import side_stream
from usdface.core.sidecars import edits_path, weights_path
from usdface.core.text import first_few
from usdface.usdio.authoring import (
    author_timing,
    define_prim,
    define_reference_prim,
    move_samples,
    prim_paths_in,
    top_path,
)
from usdface.usdio.layers import (
    author_provenance,
    new_layer,
    open_layer,
    open_stage,
    read_provenance,
    relative_path,
    save_layer,
    sublayer_asset,
    usd_errors_as_input_errors,
)
from usdface.usdio.performance.clips import PartsWriter, clear_parts, writing_parts
from usdface.usdio.performance.driving_layers import (
    DRIVING_PATHS,
    copy_driving_layer,
    opened_driving_layer,
)
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import (
    ANIMATION,
    VARIANT_SET,
    WeightsHeader,
    WeightsWriter,
    writing_weights,
)
from usdface.usdio.rig.reference import (
    define_reference,
    remove_reference,
    rig_path_of,
    variant_choices,
)
from usdface.usdio.units import author_units


def write_package(
    target: Path, reader: PerformanceReader, weights: Path, *, provenance: Provenance | None = None
) -> None:
    """Write a ``.usdz`` of a performance, with another layer of weights.

    Parameters
    ----------
    weights : Path
        Layer of weights, whose folder is used for intermediate files.
    provenance : Provenance, optional
        Stored in the package's first layer.
    """
    rig_file, rig_prim = reader.rig()
    source = top_path(rig_prim)
    rig_path = Sdf.Path(rig_path_of(reader.stage, reader.animation))
    top_file = weights.with_name("review.usdc")
    with usd_errors_as_input_errors(target, "packing it"):
        top = Sdf.Layer.CreateNew(str(top_file))
        author_units(top, like=rig_file)
        author_provenance(top, provenance)
        author_timing(top, rate=reader.rate, first=reader.first_frame, last=reader.last_frame)
        top.defaultPrim = top_path(rig_path).name
        driving = [weights.with_name(path_of(reader.path).name) for path_of in DRIVING_PATHS]
        below = [*_copy_driving_layers(reader, driving), weights]
        top.subLayerPaths = [f"./{each.name}" for each in below]
        for above in rig_path.GetParentPath().GetPrefixes():
            define_prim(top, above, "Xform")
        define_reference_prim(top, rig_path, str(rig_file), source)
        _copy_rig_use(top, reader, str(source))
        save_layer(top, target)
        _, _, missing = UsdUtils.ComputeAllDependencies(str(top_file))
        if missing:
            raise InputError(
                f"{rig_file}: {len(missing)} files that the rig refers to cannot be found: "
                f"{first_few(missing)}; put them back, or package another rig"
            )
        made = UsdUtils.CreateNewUsdzPackage(str(top_file), str(target))
    if not made or not _is_whole(target):
        raise InputError(
            f"{target}: USD could not write the package whole; is the disk full? Free it, or write "
            "elsewhere"
        )
    _zero_times(target)


def _copy_rig_use(top: Sdf.Layer, copied: PerformanceReader, rig_prim: str) -> None:
    """Copy a performance's variants of its rig, and its reference to the rig's joint animation.

    `rig_prim`: the referenced prim of the rig's file.
    """
    rig_path, header = rig_path_of(copied.stage, copied.animation), copied.header
    rig_file, _ = copied.rig()
    for path, name, choice in variant_choices(copied.stage, rig_path, rig_file, rig_prim):
        at = Sdf.Path(path).ReplacePrefix(rig_prim, rig_path)
        Sdf.CreatePrimInLayer(top, at).variantSelections[name] = choice
    rig_stage, kept = open_stage(rig_file), list[Sdf.Reference]()
    for arc in Usd.PrimCompositionQuery(copied.animation).GetCompositionArcs():
        above, to_root = arc.GetIntroducingNode(), arc.GetIntroducingNode().mapToRoot
        if arc.IsAncestral() or arc.GetTargetNode().layerStack != above.layerStack:
            continue
        at = to_root.MapSourceToTarget(arc.GetTargetPrimPath())
        inside = at.ReplacePrefix(rig_path, rig_prim)
        if at == header.animation or not (
            at.HasPrefix(rig_path) and rig_stage.GetPrimAtPath(inside)
        ):
            continue
        moved, (_, reference) = to_root.timeOffset, arc.GetIntroducingListEditor()
        # USD scales by the rates of layers itself, there and here.
        rate_ratio = above.layerStack.identifier.rootLayer.timeCodesPerSecond / float(copied.rate)
        moved = Sdf.LayerOffset(moved.offset, moved.scale * rate_ratio) * reference.layerOffset
        kept.append(Sdf.Reference("", at, moved))
    if kept:
        Sdf.CreatePrimInLayer(top, header.animation).referenceList.prependedItems = kept


def _copy_driving_layers(
    copied: PerformanceReader, targets: Sequence[Path], provenance: Provenance | None = None
) -> list[Path]:
    """Copy the driving layers of a performance, moved as its layers move them, to targets.

    Returns the targets that were written.
    """
    written, rig_path = list[Path](), rig_path_of(copied.stage, copied.animation)
    for path_of, target in zip(DRIVING_PATHS, targets, strict=True):
        found = opened_driving_layer(copied, path_of)
        if found is not None:
            with new_layer(target, provenance) as copy:
                copy_driving_layer(copy, found[0], rig_path)
                move_samples(copy, found[1])
                ends = copied.first_frame, copied.last_frame
                author_timing(copy, rate=copied.rate, first=ends[0], last=ends[1])
            written.append(target)
    return written


def _is_whole(target: Path) -> bool:
    """Whether a package is complete; USD does not report failed writes."""
    try:
        with zipfile.ZipFile(target) as package:
            return package.testzip() is None
    except (zipfile.BadZipFile, OSError, EOFError, ValueError):
        return False


_NO_TIME = struct.pack("<HH", 0, 0x0021)
"""1 January 1980 in zip files."""


def _zero_times(target: Path) -> None:
    """Reset the times of files in a package, so that its bytes are reproducible."""
    with zipfile.ZipFile(target) as package:
        entries = package.infolist()
        directory = package.start_dir
    with side_stream(target, "rb+") as stream:
        for entry in entries:
            stream.seek(entry.header_offset + 10)
            stream.write(_NO_TIME)
            stream.seek(directory + 12)
            stream.write(_NO_TIME)
            stream.seek(directory + 28)
            directory += 46 + sum(struct.unpack("<HHH", stream.read(6)))


@contextlib.contextmanager
def writing_performance(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    *,
    part_frames: int | None = None,
    above: Sequence[Path] = (),
    provenance: Provenance | None = None,
) -> Iterator[WeightsWriter | PartsWriter]:
    """Write a performance frame by frame; the files are replaced if the block succeeds.

    Parameters
    ----------
    path : Path
        The layer to open. Its other opinions and sublayers are preserved.
    header : WeightsHeader
        From `make_header`; frames are appended from its first to its last.
    part_frames : int, optional
        Write the weights as parts of this many frames, played as value clips; by default one layer.
    above
        As in `writing_top`.
    """
    writing: AbstractContextManager[WeightsWriter | PartsWriter]
    if part_frames is None:
        writing = writing_weights(weights_path(path), header, rig, provenance=provenance)
    else:
        writing = writing_parts(
            weights_path(path), header, rig, part_frames=part_frames, provenance=provenance
        )
    with writing_top(path, header, rig, above=above, provenance=provenance), writing as writer:
        yield writer


@contextlib.contextmanager
def writing_top(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    *,
    above: Sequence[Path] = (),
    copied: PerformanceReader | None = None,
    provenance: Provenance | None = None,
) -> Iterator[None]:
    """Write the top layer of a performance around the writing of its weights.

    All files are replaced together; the top layer is locked during the block.

    Parameters
    ----------
    above : sequence of Path
        Those of its head and controls layers that are written, as sublayers above the weights; the
        others are removed from its sublayers.
    copied : PerformanceReader, optional
        With the rig at the same path, whose head and controls layers, variant selections and
        reference to the rig's animation of joints are copied.
    """
    driving = [path_of(path) for path_of in DRIVING_PATHS]
    with (
        replacing_group((path, weights_path(path), *driving)),
        new_layer(path, provenance) as layer,
    ):
        check_not_written_since(path)
        rig_before, files_before = _previous(path)
        yield
        if copied is not None:
            above = _copy_driving_layers(copied, driving, provenance)
        if path.is_file():
            layer.TransferContent(open_layer(path))
        author_units(layer, like=rig.file)
        layer.defaultPrim = top_path(header.rig_path).name
        weights_asset = sublayer_asset(layer, weights_path(path), path)
        below = list(layer.subLayerPaths)
        is_open = weights_asset in below
        moved = layer.subLayerOffsets[below.index(weights_asset)] if is_open else Sdf.LayerOffset()
        ends = (header.first_frame, header.last_frame)
        first, last = (moved.offset + moved.scale * each for each in ends)
        author_timing(layer, rate=header.rate, first=first, last=last)
        define_reference(layer, header.rig_path, rig, path, replace_rig=is_open)
        if copied is not None:
            _copy_rig_use(layer, copied, str(top_path(rig.prim)))
        if rig_before not in ("", header.rig_path):
            remove_reference(layer, rig_before, {rig.file.resolve(), *files_before}, path)
        if not is_open:
            layer.subLayerPaths.append(weights_asset)
        for each in driving:
            asset = sublayer_asset(layer, each, path)
            _open_above(layer, asset, weights_asset, wanted=each in above)
        edits_asset = sublayer_asset(layer, edits_path(path), path)
        if edits_path(path).is_file() and edits_asset not in list(layer.subLayerPaths):
            # The top layer is new, the edits are not.
            layer.subLayerPaths.insert(0, edits_asset)
    clear_parts(weights_path(path))


def _open_above(layer: Sdf.Layer, asset: str, other: str, *, wanted: bool) -> None:
    """Insert a sublayer just above another, with its layer offset, or remove it."""
    if asset in list(layer.subLayerPaths):
        layer.subLayerPaths.remove(asset)
    if wanted:
        at = list(layer.subLayerPaths).index(other)
        layer.subLayerPaths.insert(at, asset)
        layer.subLayerOffsets[at] = layer.subLayerOffsets[at + 1]


def _previous(path: Path) -> tuple[str, frozenset[Path]]:
    """Return the rig's prim path, empty if unknown, and inputs of a performance written again."""
    if not (path.is_file() and weights_path(path).is_file()):
        return "", frozenset()
    try:
        layer = open_layer(weights_path(path))
        animations = [each for each in prim_paths_in(layer) if each.name.startswith(ANIMATION)]
        made = read_provenance(path)
    except InputError:  # damaged, and about to be replaced
        return "", frozenset()
    folder, inputs = path.resolve().parent, () if made is None else made.inputs
    rig_path = str(animations[0].GetParentPath()) if len(animations) == 1 else ""
    return rig_path, frozenset((folder / each).resolve() for each in inputs)


def write_takes(
    path: Path,
    takes: Mapping[str, PerformanceReader],
    *,
    provenance: Provenance | None = None,
) -> None:
    """Write an asset of several takes of one character, a variant for each; the first is shown.

    Variants reference the performances, and so follow their changes. The range of the layer spans
    all takes, as variants cannot change it.

    `takes`: performances of one rig at one path and rate, by the name of the variant.
    """
    first = next(iter(takes.values()))
    top = top_path(first.header.rig_path)
    with new_layer(path, provenance) as layer:
        author_units(layer, like=first.path)
        author_timing(
            layer,
            rate=first.rate,
            first=min(each.first_frame for each in takes.values()),
            last=max(each.last_frame for each in takes.values()),
        )
        layer.defaultPrim = top.name
        prim = Sdf.CreatePrimInLayer(layer, top)
        prim.specifier = Sdf.SpecifierDef
        prim.SetInfo("kind", Kind.Tokens.component)
        variants = Sdf.VariantSetSpec(prim, VARIANT_SET)
        prim.variantSetNameList.prependedItems = [VARIANT_SET]
        prim.variantSelections[VARIANT_SET] = next(iter(takes))
        for name, reader in takes.items():
            variant = Sdf.VariantSpec(variants, name)
            reference = Sdf.Reference(relative_path(reader.path, path), top)
            variant.primSpec.referenceList.prependedItems = [reference]
