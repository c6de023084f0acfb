"""Files of `select`: pictures of the pairs, references and a placement made with them."""

from usdface.core.assets import References, Rig, Take
from usdface.core.errors import InputError
from usdface.core.locks import tuning_lock
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing_group
from usdface.core.sidecars import binding_layers, placement_path, reference_layers, tuned_path
from usdface.core.text import pluralize
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.tuned_pairs import PlacedPair
from usdface.steps.references.images import PairImages, remove_unused_images, write_pair_images
from usdface.usdio.references.weight_layers import read_tuned_pairs
from usdface.usdio.references.write import write_references
from usdface.usdio.surface.placement import RigPlacement, write_placement


def store_images(
    spec: SelectSpec,
    references: References,
    sources: tuple[Take, ...],
    provenance: Provenance,
    progress: Progress,
) -> PairImages:
    """Store the video frames of the pairs, unless --no-images is given."""
    if not spec.images:
        return PairImages((), ())
    progress(0.0, "storing the video frames of the pairs")
    return write_pair_images(spec.out, references, sources, metadata=provenance.metadata)


def write_selection(
    spec: SelectSpec,
    references: References,
    rig: Rig,
    kept: list[PlacedPair],
    images: PairImages,
    provenance: Provenance,
    placement: RigPlacement | None = None,
) -> None:
    """Write references, and a placement made here, unless pairs were tuned since they were read."""
    written = (*binding_layers(placement_path(spec.out)), *reference_layers(spec.out))
    with tuning_lock(spec.out), replacing_group(written):
        _check_tuning_is_as_read(spec, kept)
        if placement is not None:
            write_placement(placement_path(spec.out), placement, rig, provenance=provenance)
        write_references(
            spec.out,
            references,
            rig,
            tuned=[each.tuned for each in kept if each.is_keyed],
            images=images.files,
            provenance=provenance,
        )
    remove_unused_images(spec.out, images.files)


def _check_tuning_is_as_read(spec: SelectSpec, kept: list[PlacedPair]) -> None:
    """Refuse to write if pairs were tuned since they were read."""
    now = {(each.pair, each.take, each.frame) for each in read_tuned_pairs(tuned_path(spec.out))}
    before = {(each.tuned.pair, each.tuned.take, each.tuned.frame) for each in kept}
    if now - before:
        raise InputError(
            f"{tuned_path(spec.out)}: {pluralize(len(now - before), 'pair')} tuned while frames "
            "were chosen; nothing was changed. Select again, which keeps tuned pairs"
        )
