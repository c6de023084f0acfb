"""Place the markers of takes on a rig, with a verdict and a picture."""

from functools import partial

from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import binding_layers
from usdface.core.text import first_few, pluralize
from usdface.media.picture.image import write_image
from usdface.runner.result import StepResult
from usdface.specs.references import PlaceSpec
from usdface.steps.inputs.cleaned_takes import plausibility_notes, read_cleaned_takes
from usdface.steps.inputs.landmark_files import read_landmarks
from usdface.steps.inputs.placed_takes import (
    PlacementScene,
    draw_placement,
    place_takes,
    placement_figures,
    placement_notes,
)
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.placement import write_placement


def run(spec: PlaceSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Place the markers, keeping earlier corrections, and write and draw the placement."""
    takes = read_cleaned_takes(spec.takes)
    rig = read_rig(spec.rig, prim=spec.prim)
    notes = plausibility_notes(takes, spec.takes, rig)
    landmarks = read_landmarks(spec.landmarks, takes.marker_names, rig)
    progress(0.2, "placing the markers on the rig")
    placing = partial(PlacementScene.place, out=spec.out, landmarks=landmarks)
    takes, placed, moved = place_takes(takes, rig, placing)
    write_placement(spec.out, placed.placement, rig, provenance=provenance)
    if spec.picture is not None:
        progress(0.7, f"drawing {spec.picture.name}")
        title = f"{first_few([source.name for source in takes.sources], most=3)} on {spec.rig.stem}"
        picture = draw_placement(placed, rig, title=title, quality=spec.quality)
        write_image(spec.picture, picture, metadata=provenance.metadata)
    return StepResult(
        (*binding_layers(spec.out), *spec.paths_of("picture")),
        f"{pluralize(len(takes.marker_names), 'marker')} on {rig.file.name}. "
        f"{placed.verdict.sentence}",
        (*notes, *moved, *placement_notes(placed)),
        placement_figures(placed),
    )
