"""Pack a performance for review into one .usdz."""

from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.core.side_files import emptied_side_folder
from usdface.core.sidecars import work_folder
from usdface.runner.result import StepResult
from usdface.specs.edits import BakeSpec, PackageSpec
from usdface.steps.edits import bake
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.write import write_package


def run(spec: PackageSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Bake the edits, and pack the weights with the rig and its dependencies."""
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    with (
        replacing(spec.out) as temporary,
        emptied_side_folder(work_folder(spec.out, "package")) as folder,
    ):
        baked = folder / "weights.usdc"
        report = bake.run(
            BakeSpec(performance=spec.performance, out=baked, prim=spec.prim),
            provenance=provenance,
            progress=part(progress, 0.0, 0.7),
        )
        write_package(temporary, reader, baked, provenance=provenance)
    packed_too = bake.driving_notes(reader)  # a package has these layers as well
    size = spec.out.stat().st_size / 1e6
    return StepResult(
        (spec.out,),
        f"{report.summary}; {size:.1f} MB",
        tuple(note for note in report.notes if note not in packed_too),
        {"bytes": spec.out.stat().st_size, "frames": report.figures["frames"]},
    )
