"""What every spec shares: frozen, unknown keys refused, limits in types, marked paths."""

import ast
import functools
import inspect
import itertools
import logging
import os
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from usdface.specs.paths import Reads, Writes

log = logging.getLogger(__name__)

Name = Annotated[str, Field(min_length=1, max_length=200)]
Axis = Literal["y", "z"]
Units = Literal["mm", "cm", "m", "in"]
Device = Annotated[str, Field(pattern=r"^(cpu|torch|cuda(:\d+)?)$", examples=["cpu", "cuda"])]
"""What `numerics.array_namespace` opens."""


Sidecar = Callable[[Path], Path]
"""Gives the path of a layer by that of the file that needs it, such as `core.sidecars` has."""


@dataclass(frozen=True)
class Positional:
    """Marks a field that the command line takes without an option's name."""


@functools.cache
def field_help(spec: type) -> dict[str, str]:
    """Return the text that stands beneath each field of a class, those it inherits included.

    Pydantic would read the source of every spec whenever a command starts. Where the package was
    installed without its source there is no help, and all else works.
    """
    texts: dict[str, str] = {}
    for each in reversed(spec.__mro__):
        if each.__module__.startswith(__package__):
            texts |= _class_help(each)
    return texts


def _class_help(spec: type) -> dict[str, str]:
    try:
        source = inspect.getsource(spec)
    except OSError:
        return {}
    (tree,) = ast.parse(textwrap.dedent(source)).body
    assert isinstance(tree, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in itertools.pairwise(tree.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _marks_within(annotation: Any) -> list[Any]:
    """Return the marks inside an optional type: pydantic lifts only the outermost."""
    marks = list(getattr(annotation, "__metadata__", ()))
    for inner in get_args(annotation):
        marks += _marks_within(inner)
    return marks


class Spec(BaseModel):
    """One unit of work: what to read, what to write, how."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        defer_build=True,  # a command starts with all specs, and validates one
    )

    example: ClassVar[str] = ""
    """A command line that shows the common use."""

    module: ClassVar[str] = ""
    """Where the step's function is, below ``usdface.steps``: its workflow, then its file."""

    section: ClassVar[str] = ""
    """Workflow under which the command line lists it; that of `module` by default."""

    makes: ClassVar[str] = ""
    """Kind of its output: a step may replace what another of the same kind wrote. By default a kind
    of its own."""

    sidecar: ClassVar[Sidecar | None] = None
    """Where the layer is that the step writes beneath an output, by the output's path."""

    cores: ClassVar[int] = 1
    """Least processor cores that a farm's worker needs."""

    memory_mib: ClassVar[int] = 2048
    """Least memory [MiB] that a farm's worker needs; enough for what streams over frames."""

    in_place: ClassVar[bool] = False
    """Whether an output may take the place of an input."""

    renamed: ClassVar[Mapping[str, str]] = {}
    """Old names of fields, with the new: accepted for one version, with a warning."""

    removed: ClassVar[Mapping[str, str]] = {}
    """Names of fields that are gone, each with what to do instead; refused with this advice."""

    step: str

    @model_validator(mode="before")
    @classmethod
    def _old_names_are_accepted(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not cls.renamed.keys() & data.keys():
            return data
        for old in cls.renamed.keys() & data.keys():
            new = cls.renamed[old]
            if new in data:
                raise ValueError(f"{old} is now called {new}, and both are given; keep {new}")
            warn_of_old_name(cls.step_name(), old, new)
        return {cls.renamed.get(name, name): value for name, value in data.items()}

    @model_validator(mode="after")
    def _names_are_text(self) -> Self:
        for path in (*self.paths(Reads), *self.paths(Writes)):
            try:
                str(path).encode()
            except UnicodeEncodeError as error:
                raise ValueError(
                    f"{str(path)!a} holds bytes that are no text, and no USD layer can name such "
                    "a file: rename it"
                ) from error
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        schema = handler(core)
        properties = handler.resolve_ref_schema(schema)["properties"]
        for name, text in field_help(cls).items():
            if name in properties:
                properties[name].setdefault("description", text)
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
        """Return the kind of file that the step makes; steps of one kind replace each other's."""
        return cls.makes or cls.step_name()

    @classmethod
    def fields_marked(cls, kind: type[Any]) -> dict[str, Any]:
        """Return the fields that carry a mark of this kind, with the mark."""
        return {
            name: mark
            for name, field in cls.model_fields.items()
            for mark in (*field.metadata, *_marks_within(field.annotation))
            if isinstance(mark, kind)
        }

    def paths(self, kind: type[Reads] | type[Writes]) -> tuple[Path, ...]:
        """Return every path this spec reads, or every path it writes."""
        paths: list[Path] = []
        for name in type(self).fields_marked(kind):
            value = getattr(self, name)
            if isinstance(value, Path):
                paths.append(value)
            elif value is not None:
                paths.extend(value)
        return tuple(paths)

    def read_alone(self) -> tuple[Path, ...]:
        """Return the paths of which only the file itself counts, not what it refers to."""
        marks = type(self).fields_marked(Reads)
        return tuple(
            path
            for name, mark in marks.items()
            if mark.alone and isinstance(path := getattr(self, name), Path)
        )

    def outputs(self) -> tuple[Path, ...]:
        """Return the files this spec makes: those that tell whether it has been done."""
        return self.paths(Writes)

    def named_paths(self) -> Sequence[tuple[str, Path]]:
        """Return every path that the step reads, writes or changes, each with the step's name."""
        every = (*self.paths(Reads), *self.paths(Writes), *self.changes())
        return [(self.step, path) for path in dict.fromkeys(every)]

    def changes(self) -> tuple[Path, ...]:
        """Return the files that are other files once this spec has been done."""
        return self.outputs()

    def anchored(self, folder: Path) -> Self:
        """Return the same spec with its relative paths taken from a folder."""
        return self.with_paths(lambda path: folder / path)

    def relative_to(self, folder: Path) -> Self:
        """Return the same spec with paths as they read from a folder, as a saved spec needs."""
        return self.with_paths(
            lambda path: path if path.is_absolute() else Path(os.path.relpath(path, folder))
        )

    def with_paths(self, change: Callable[[Path], Path]) -> Self:
        """Return the same spec with every path it reads or writes changed."""
        changed: dict[str, Any] = {}
        for kind in (Reads, Writes):
            for name in type(self).fields_marked(kind):
                value = getattr(self, name)
                if isinstance(value, Path):
                    changed[name] = change(value)
                elif value is not None:
                    changed[name] = tuple(change(each) for each in value)
        return self.model_copy(update=changed)


@functools.cache
def warn_of_old_name(step: str, old: str, new: str) -> None:
    """Log, once a process, that a field was called by its old name."""
    log.warning(
        "%s: %s is now called %s; the old name is accepted in this version alone", step, old, new
    )
