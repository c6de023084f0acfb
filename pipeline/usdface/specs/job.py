"""A job: steps in the order they build on each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_args

from pydantic import ConfigDict, Field, model_validator

from usdface.specs.base import Name, Spec
from usdface.specs.capture import AlignSpec, CleanSpec, IngestSpec, PhonesSpec, TrackSpec
from usdface.specs.edits import BakeSpec, CombineSpec, EditsImportSpec, EditSpec, PackageSpec
from usdface.specs.paths import Reads, Writes
from usdface.specs.performance import JoinSpec, MapSpec, TrainSpec
from usdface.specs.references import (
    PlaceSpec,
    ReferencesAddSpec,
    ReferencesCoverageSpec,
    ReferencesFromEditsSpec,
    ReferenceSheetSpec,
    ReferencesImportSpec,
    SelectSpec,
)
from usdface.specs.retarget import (
    CyclicSpec,
    FindSequencesSpec,
    MakeSequenceSpec,
    PairsImportSpec,
    PairsProposeSpec,
    RetargetSpec,
    TrainRetargetSpec,
    WarpSpec,
)
from usdface.specs.review import (
    EvaluateSpec,
    FacesSpec,
    MovieJoinSpec,
    MovieSpec,
    ReportSpec,
    SheetSpec,
)
from usdface.specs.surface import BindSpec, DeformSpec, LogicSpec, MakeShapesSpec
from usdface.specs.takes import FOR_EACH_SCHEMA, TAKES_SCHEMA, write_out

AnyStep = Annotated[
    IngestSpec
    | TrackSpec
    | AlignSpec
    | CleanSpec
    | PhonesSpec
    | PlaceSpec
    | SelectSpec
    | ReferencesImportSpec
    | ReferenceSheetSpec
    | ReferencesCoverageSpec
    | TrainSpec
    | MapSpec
    | JoinSpec
    | BakeSpec
    | CombineSpec
    | PackageSpec
    | ReferencesFromEditsSpec
    | ReferencesAddSpec
    | SheetSpec
    | MovieSpec
    | MovieJoinSpec
    | ReportSpec
    | EvaluateSpec
    | BindSpec
    | DeformSpec
    | MakeShapesSpec
    | LogicSpec
    | PairsProposeSpec
    | PairsImportSpec
    | TrainRetargetSpec
    | RetargetSpec
    | CyclicSpec
    | MakeSequenceSpec
    | FindSequencesSpec
    | WarpSpec
    | FacesSpec,
    Field(discriminator="step"),
]

STEP_SPECS: tuple[type[Spec], ...] = get_args(get_args(AnyStep)[0])
"""All steps of a job, in the order of the workflow."""

_BAKE = STEP_SPECS.index(BakeSpec)
COMMAND_SPECS: tuple[type[Spec], ...] = (
    *STEP_SPECS[:_BAKE],
    EditSpec,
    EditsImportSpec,
    *STEP_SPECS[_BAKE:],
)
"""All steps with a command: those of a job, and edits, which are not repeatable."""

SPEC_BY_STEP = {spec.step_name(): spec for spec in COMMAND_SPECS}


def _with_takes(schema: dict[str, Any]) -> None:
    """Add `takes` and `for_each`, which are expanded before steps are validated, to the schema."""
    schema["properties"]["takes"] = TAKES_SCHEMA
    steps = schema["properties"]["steps"]
    steps["items"] = {"anyOf": [steps["items"], FOR_EACH_SCHEMA]}


class JobSpec(Spec):
    """Several steps in one file; relative paths are relative to it.

    With `takes`, steps under `for_each: take` run once per take.
    """

    model_config = ConfigDict(json_schema_extra=_with_takes)

    example: ClassVar[str] = "usdface run kitchen.job.yaml"

    step: str = "job"
    job: Name
    """Name of the job."""
    steps: Annotated[tuple[AnyStep, ...], Field(min_length=1)]
    """The steps, each after the steps whose outputs it reads."""

    def named_paths(self) -> Sequence[tuple[str, Path]]:
        """Return the paths of every step, each with the step's name."""
        return [pair for step in self.steps for pair in step.named_paths()]

    @model_validator(mode="before")
    @classmethod
    def _takes_are_written_out(cls, data: Any) -> Any:
        return write_out(data) if isinstance(data, dict) else data

    @model_validator(mode="after")
    def _files_are_made_once_and_before_they_are_read(self) -> Self:
        made: dict[Path, int] = {}
        for number, step in enumerate(self.steps, start=1):
            for path in step.outputs():
                if path in made:
                    raise ValueError(
                        f"steps {made[path]} and {number} both write {path}; use two names"
                    )
                made[path] = number
        for number, step in enumerate(self.steps, start=1):
            for path in step.paths(Reads):
                if made.get(path, 0) > number:
                    raise ValueError(
                        f"step {number} reads {path} before step {made[path]} writes it; swap them"
                    )
                if path in step.paths(Writes):
                    raise ValueError(
                        f"step {number} reads and writes {path}; choose another output"
                    )
        return self
