"""One .usdz with a rig, its textures and the weights that move it."""

import struct
import zipfile
from pathlib import Path

from pxr import Sdf, UsdUtils

from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.usdio.authoring import author_timing
from usdface.usdio.layers import provenance_data, usd_errors_as_input_errors
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.reference import carry_variants, place_of
from usdface.usdio.units import author_units


def write_package(
    target: Path,
    reader: PerformanceReader,
    weights: Path,
    *,
    provenance: Provenance | None = None,
) -> None:
    """Pack a performance with another layer of weights in place of its own.

    Parameters
    ----------
    target : Path
        The .usdz to write.
    reader : PerformanceReader
        Whose rig is packed, at the place it has there.
    weights : Path
        Layer that animates it; what is written besides is put into its folder.
    provenance : Provenance, optional
        Kept by the package's first layer.

    Raises
    ------
    InputError
        If something that the rig refers to cannot be found.
    """
    rig_file, rig_prim = reader.rig()
    source = Sdf.Path(rig_prim).GetPrefixes()[0]
    place = Sdf.Path(place_of(reader.stage, reader.animation))
    top_file = weights.with_name("review.usdc")
    with usd_errors_as_input_errors(target, "packing it"):
        top = Sdf.Layer.CreateNew(str(top_file))
        author_units(top, like=rig_file)
        if provenance is not None:
            top.customLayerData = {"usdface": provenance_data(provenance)}
        author_timing(top, rate=reader.rate, first=reader.first_frame, last=reader.last_frame)
        top.defaultPrim = place.GetPrefixes()[0].name
        top.subLayerPaths = [f"./{weights.name}"]
        for above in place.GetParentPath().GetPrefixes():
            prim = Sdf.CreatePrimInLayer(top, above)
            prim.specifier, prim.typeName = Sdf.SpecifierDef, "Xform"
        prim = Sdf.CreatePrimInLayer(top, place)
        prim.specifier = Sdf.SpecifierDef
        prim.referenceList.prependedItems = [Sdf.Reference(str(rig_file), source)]
        carry_variants(top, reader.stage, str(place), rig_file, str(source))
        top.Save()
        _, _, missing = UsdUtils.ComputeAllDependencies(str(top_file))
        if missing:
            raise InputError(
                f"{rig_file}: {len(missing)} files that the rig refers to cannot be found: "
                f"{first_few(missing)}; put them back, or package another rig"
            )
        made = UsdUtils.CreateNewUsdzPackage(str(top_file), str(target))
    if not made:
        raise InputError(f"{target}: USD could not write the package; is the disk full?")
    _zero_times(target)


_NO_TIME = struct.pack("<HH", 0, 0x0021)
"""As zip has it, the first day of 1980."""


def _zero_times(target: Path) -> None:
    """Take out when files were made: the same performance gives the same bytes."""
    with zipfile.ZipFile(target) as package:
        entries = package.infolist()
        directory = package.start_dir
    with target.open("r+b") as stream:
        for entry in entries:
            stream.seek(entry.header_offset + 10)
            stream.write(_NO_TIME)
            stream.seek(directory + 12)
            stream.write(_NO_TIME)
            stream.seek(directory + 28)
            directory += 46 + sum(struct.unpack("<HHH", stream.read(6)))
