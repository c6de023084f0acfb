"""Several takes on one character: an asset with a variant per take.

Each variant references the performance as it is, so that edits and new solves of a take arrive
without combining again. The range of the layer spans all takes: variants cannot change it.
"""

from collections.abc import Mapping
from pathlib import Path

from pxr import Kind, Sdf

from usdface.core.provenance import Provenance
from usdface.usdio.authoring import author_timing
from usdface.usdio.layers import new_layer, relative_path
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.units import author_units

VARIANT_SET = "take"


def write_takes(
    path: Path,
    takes: Mapping[str, PerformanceReader],
    *,
    shown: str,
    provenance: Provenance | None = None,
) -> None:
    """Write the asset.

    Parameters
    ----------
    takes : mapping of str to PerformanceReader
        Performances of one rig at one place and rate, by the name of the variant.
    shown : str
        The variant that is selected.
    """
    first = next(iter(takes.values()))
    top = Sdf.Path(first.header.place).GetPrefixes()[0]
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
        prim.variantSelections[VARIANT_SET] = shown
        for name, reader in takes.items():
            variant = Sdf.VariantSpec(variants, name)
            reference = Sdf.Reference(relative_path(reader.path, path), top)
            variant.primSpec.referenceList.prependedItems = [reference]
