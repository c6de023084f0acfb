"""What every spec shares: frozen, unknown keys refused, limits in types, marked paths."""

import ast
import functools
import inspect
import itertools
import os
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema


@functools.cache
def field_help(spec: type) -> dict[str, str]:
    """Return the text that stands beneath each field of a class, those it inherits included.

    Pydantic would read the source of every spec whenever a command starts. Where the package was
    installed without its source there is no help, and all else works.

    Parameters
    ----------
    spec : type
    """
    found: dict[str, str] = {}
    for each in reversed(spec.__mro__):
        if each.__module__.startswith(__package__):
            found |= _own_help(each)
    return found


def _own_help(spec: type) -> dict[str, str]:
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


FRAMES_PATTERN = r"^-?\d+--?\d+$"


@dataclass(frozen=True)
class Reads:
    """Marks a path that a step reads.

    Attributes
    ----------
    alone : bool
        Only this very file matters, not the layers it is built from.
    """

    alone: bool = False


@dataclass(frozen=True)
class Writes:
    """Marks a path that a step writes."""


@dataclass(frozen=True)
class Positional:
    """Marks a field that the command line takes without an option's name."""


def _named(path: Path) -> Path:
    if not path.name:
        raise ValueError(f"{str(path)!r} names no file")
    return path


FilePath = Annotated[Path, AfterValidator(_named)]
ReadPath = Annotated[FilePath, Reads()]
WritePath = Annotated[FilePath, Writes()]


def _ending(suffixes: tuple[str, ...], what: str) -> Callable[[Path], Path]:
    def check(path: Path) -> Path:
        if path.suffix.lower() not in suffixes:
            raise ValueError(f"{what} is written, so the name must end in {', '.join(suffixes)}")
        return path

    return check


LAYER_SUFFIXES = (".usda", ".usdc", ".usd")
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff")

LayerOut = Annotated[WritePath, AfterValidator(_ending(LAYER_SUFFIXES, "a USD layer"))]
ImageOut = Annotated[WritePath, AfterValidator(_ending(IMAGE_SUFFIXES, "a picture"))]
Name = Annotated[str, Field(min_length=1, max_length=200)]

PRIM_PATTERN = r"(/[^\x00-@\[-^`{-\x7f][^\x00-/:-@\[-^`{-\x7f]*)+"
"""Of prims in any script, as USD has them; which letters may stand in a name, Python knows."""


def prim_path(path: str) -> str:
    """Return the path of a prim, or refuse what USD would not take for one."""
    if not all(name.isidentifier() for name in path.split("/")[1:]):
        raise ValueError("give the path of a prim, such as /shot/cast/hero")
    return path


PrimPath = Annotated[str, Field(pattern=f"^{PRIM_PATTERN}$"), AfterValidator(prim_path)]
Device = Annotated[str, Field(pattern=r"^(cpu|torch|cuda(:\d+)?)$", examples=["cpu", "cuda"])]
"""What `numerics.array_namespace` opens."""


def _in_order(frames: str) -> str:
    first, last = _split_frames(frames)
    if last < first:
        raise ValueError(f"the last frame, {last}, precedes the first, {first}")
    return frames


Frames = Annotated[
    str, Field(pattern=FRAMES_PATTERN, examples=["101-240"]), AfterValidator(_in_order)
]


def frame_range(frames: str | None) -> tuple[int, int] | None:
    """Turn ``"101-240"`` into (101, 240); None stays None."""
    return None if frames is None else _split_frames(frames)


def _split_frames(frames: str) -> tuple[int, int]:
    split = frames.index("-", 1)
    return int(frames[:split]), int(frames[split + 1 :])


def _marks_within(annotation: Any) -> list[Any]:
    """Return the marks inside an optional type: pydantic lifts only the outermost."""
    found = list(getattr(annotation, "__metadata__", ()))
    for inner in get_args(annotation):
        found += _marks_within(inner)
    return found


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
    """Where the step's function is, below ``usdface.steps``."""

    in_place: ClassVar[bool] = False
    """Whether an output may take the place of an input."""

    step: str

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
    def fields_marked(cls, kind: type[Any]) -> dict[str, Any]:
        """Return the fields that carry a mark of this kind, with the mark."""
        found = {}
        for name, field in cls.model_fields.items():
            marks = (*field.metadata, *_marks_within(field.annotation))
            for mark in marks:
                if isinstance(mark, kind):
                    found[name] = mark
        return found

    def paths(self, kind: type[Reads] | type[Writes]) -> tuple[Path, ...]:
        """Return every path this spec reads, or every path it writes."""
        found: list[Path] = []
        for name in type(self).fields_marked(kind):
            value = getattr(self, name)
            if isinstance(value, Path):
                found.append(value)
            elif value is not None:
                found.extend(value)
        return tuple(found)

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


Axis = Literal["y", "z"]
Units = Literal["mm", "cm", "m", "in"]
