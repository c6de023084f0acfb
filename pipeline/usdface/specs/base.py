"""Base class of all specs: frozen, no unknown keys, limits in types, marked paths."""

import ast
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic_core import CoreSchema

from usdface.specs.paths import ReadPath, Reads, Several, Writes

Name = Annotated[str, Field(min_length=1, max_length=200)]
Axis = Annotated[
    Literal["y", "z", "x", "-x", "-y", "-z"],
    BeforeValidator(lambda given: given.lower() if isinstance(given, str) else given),
]
Units = Literal["mm", "cm", "m", "in"]

DRIVEN_PARTS = ("head", "left_eye", "right_eye")


def _parts_once(drive: tuple[str, ...]) -> tuple[str, ...]:
    parts = [each.partition("=")[0] for each in drive]
    for each, part in zip(drive, parts, strict=True):
        if part not in DRIVEN_PARTS or each in (part, f"{part}="):
            raise ValueError(
                f"{each!r} is not PART=NAME; the parts are {', '.join(DRIVEN_PARTS)}, the name is "
                "that of a joint or an Xform of the rig"
            )
        if parts.count(part) > 1:
            raise ValueError(f"{part} is given twice; it drives one joint or Xform")
    return drive


Drive = Annotated[tuple[Name, ...], Several, AfterValidator(_parts_once)]

OnlyWith = Mapping[str, tuple[str, Sequence[str]]]
"""``{option: (other, values)}``: `other` must have one of `values`, or must be given if there are
none."""

NeverWith = Mapping[str, Sequence[str]]
"""``{option: others}``"""

Sidecar = Callable[[Path], Path]
"""Function from the path of a file to that of a layer it needs; see `core.sidecars`."""


@dataclass(frozen=True)
class Positional:
    """Marks a field that is an argument of the command line, not an option."""


def _marks_within(annotation: Any) -> list[Any]:
    """Return the marks inside an optional type; pydantic collects only the outermost."""
    marks = list(getattr(annotation, "__metadata__", ()))
    for inner in get_args(annotation):
        marks += _marks_within(inner)
    return marks


@cache
def _marks(spec: type["Spec"]) -> list[tuple[str, Any]]:
    """Return the marks of a spec's fields, with the field of each."""
    return [
        (name, mark)
        for name, field in spec.model_fields.items()
        for mark in (*field.metadata, *_marks_within(field.annotation))
    ]


@cache
def field_help(spec: type["Spec"]) -> Mapping[str, str]:
    """Return the docstrings of a spec's fields.

    For the command that runs: pydantic's `use_attribute_docstrings` would read those of all specs
    when any command starts, a quarter of the time that ``--help`` takes. Empty where the package is
    installed without its source.
    """
    found = {}
    for owner in reversed(spec.__mro__[: spec.__mro__.index(Spec) + 1]):
        try:
            (tree,) = ast.parse(inspect.getsource(owner)).body
        except OSError:
            return {}
        for field, text in pairwise(getattr(tree, "body", ())):
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(docstring))),
                ):
                    found[name] = inspect.cleandoc(docstring)
    return {name: found[name] for name in spec.model_fields if name in found}


class Spec(BaseModel):
    """One unit of work: inputs, outputs and options."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        defer_build=True,  # a command starts with all specs, and validates one
    )

    example: ClassVar[str] = ""
    """Command line of the common use, shown in the help."""

    module: ClassVar[str] = ""
    """Module of the step below ``usdface.steps``: workflow, then file, as ``performance.map``."""

    section: ClassVar[str] = ""
    """Workflow in the list of commands. Default: that of `module`."""

    makes: ClassVar[str] = ""
    """Kind of the outputs; steps of one kind may replace each other's. Default: the step's name."""

    sidecars: ClassVar[tuple[Sidecar, ...]] = ()
    """Functions from the path of an output to the paths of the sublayers that the step writes."""

    traces: ClassVar[Sequence[str]] = ()
    """Input fields whose provenance names further files that the step reads."""

    cores: ClassVar[int] = 1
    """Processor cores requested from a farm."""

    memory_mib: ClassVar[int] = 2048
    """Memory requested from a farm [MiB]; the default suits steps that stream frames."""

    in_place: ClassVar[bool] = False
    """Whether an output may replace an input."""

    only_with: ClassVar[OnlyWith] = {}
    """Options that need another option. Refused where they would be ignored."""

    never_with: ClassVar[NeverWith] = {}
    """Options without effect if one of the others is given. Refused together."""

    step: str

    @model_validator(mode="after")
    def _no_option_is_ignored(self) -> Self:
        for name, (other, values) in type(self).only_with.items():
            chosen = getattr(self, other)
            several = chosen if isinstance(chosen, tuple) else (chosen,)
            counts = not set(several).isdisjoint(values)
            if not self.is_given(name) or counts or (not values and self.is_given(other)):
                continue
            option = other.replace("_", "-")
            needed = " or ".join(f"{option} {value}" for value in values) or option
            without = (
                f"with {other} {', '.join(map(str, several))}" if values else f"without {other}"
            )
            raise ValueError(f"{name} has no effect {without}; leave it out, or give {needed}")
        for name, others in type(self).never_with.items():
            given = [other for other in others if self.is_given(other)]
            if given and self.is_given(name):
                raise ValueError(f"{name} has no effect with {given[0]}; leave one of them out")
        return self

    def is_given(self, name: str) -> bool:
        """Whether a field differs from its default."""
        default = type(self).model_fields[name].get_default(call_default_factory=True)
        return bool(getattr(self, name) != default)

    @model_validator(mode="after")
    def _names_are_text(self) -> Self:
        for path in (*self.paths(Reads), *self.paths(Writes)):
            try:
                str(path).encode()
            except UnicodeEncodeError as error:
                raise ValueError(
                    f"{str(path)!a} is not valid Unicode, which no USD layer can refer to; rename "
                    "the file"
                ) from error
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema)["properties"]
        for name, text in field_help(cls).items():
            properties[name]["description"] = text
        return schema

    @classmethod
    def step_name(cls) -> str:
        """Return the step's name, as in a job."""
        return str(cls.model_fields["step"].default)

    @classmethod
    def workflow(cls) -> str:
        """Return the workflow that the step belongs to: ``capture``, ``references``, ..."""
        return cls.section or cls.module.partition(".")[0]

    @classmethod
    def kind_of_output(cls) -> str:
        """Return the kind of the outputs; steps of one kind may replace each other's."""
        return cls.makes or cls.step_name()

    @classmethod
    def fields_marked(cls, kind: type[Any]) -> dict[str, Any]:
        """Return the fields with a mark of this kind, and the mark."""
        return {name: mark for name, mark in _marks(cls) if isinstance(mark, kind)}

    def paths(self, kind: type[Reads] | type[Writes]) -> tuple[Path, ...]:
        """Return every path this spec reads, or every path it writes."""
        return tuple(path for name in self.fields_marked(kind) for path in self.paths_of(name))

    def paths_of(self, name: str) -> tuple[Path, ...]:
        """Return the paths in a field that holds one, several or none."""
        value = getattr(self, name)
        return (value,) if isinstance(value, Path) else tuple(value or ())

    def reads(self) -> Mapping[Path, Reads]:
        """Return the mark of every path this spec reads."""
        marks = self.fields_marked(Reads)
        return {path: mark for name, mark in marks.items() for path in self.paths_of(name)}

    def outputs(self) -> tuple[Path, ...]:
        """Return the files this spec writes, whose state decides whether it is up to date."""
        return self.paths(Writes)

    def written_binding(self) -> Path | None:
        """Return the binding or placement that the step writes, with earlier corrections kept."""
        return None

    def named_paths(self) -> Sequence[tuple[str, Path]]:
        """Return (step, path) of every path that the step reads, writes or changes."""
        every = (*self.paths(Reads), *self.paths(Writes), *self.changes())
        return [(self.step, path) for path in dict.fromkeys(every)]

    def changes(self) -> tuple[Path, ...]:
        """Return all files that the step changes."""
        return self.outputs()

    def relative_to(self, folder: Path) -> Self:
        """Return the spec with paths relative to a folder, to be saved there."""
        real = folder.resolve()  # `..` of a link leads out of its target
        return self.with_paths(
            lambda path: path if path.is_absolute() else Path(os.path.relpath(path, real))
        )

    def with_paths(self, change: Callable[[Path], Path]) -> Self:
        """Return the spec with a function applied to every path."""
        changed: dict[str, Any] = {}
        for kind in (Reads, Writes):
            for name in type(self).fields_marked(kind):
                value = getattr(self, name)
                if isinstance(value, Path):
                    changed[name] = change(value)
                elif value is not None:
                    changed[name] = tuple(change(each) for each in value)
        return self.model_copy(update=changed)


class WeightTableSpec(Spec):
    """A step that reads a table of weights."""

    weight_unit: Literal["one", "percent"] | None = None
    """Unit of a table of weights: `one`, where 1 is the full shape, or `percent`. Needed if the
    size of the weights does not show it."""


class MovedRigSpec(Spec):
    """A step that uses the rig that a performance or references refer to."""

    rig: ReadPath | None = None
    """The rig, if its file has moved since the performance or the references were written."""
