"""Commands generated from specs: each field is an option, and its docstring the help."""

import inspect
import types
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import typer
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from usdface.cli.console import ProgressStyle
from usdface.core.errors import InputError
from usdface.specs.base import Positional, Spec, field_help
from usdface.specs.reading import validation_messages

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
ShowProgress = Annotated[
    ProgressStyle,
    typer.Option(
        "--progress",
        help="Progress output. Default: a bar on a terminal, elsewhere a line every ten seconds.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace existing outputs, including newer files and files of other programs.",
    ),
]
SaveSpec = Annotated[
    Path | None,
    typer.Option(
        "--save-spec", help="Write the spec of this command to a new file, without running it."
    ),
]


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


COMMON_OPTIONS = [
    _keyword("overwrite", Overwrite, False),
    _keyword("save_spec", SaveSpec, None),
    _keyword("progress", ShowProgress, "auto"),
    _keyword("as_json", Json, False),
]
"""Options of every step's command."""

SpecType = TypeVar("SpecType", bound=Spec)


def options_of(spec: type[Spec]) -> list[inspect.Parameter]:
    """Return the command-line parameters of a spec."""
    parameters, texts = [], field_help(spec)
    for name, field in spec.model_fields.items():
        if name == "step":
            continue
        kind = _command_line_type(field.annotation)
        required = field.is_required()
        if any(isinstance(mark, Positional) for mark in field.metadata):
            info: Any = typer.Argument(help=texts.get(name), show_default=False)
        else:
            named = "<str,...>" if _is_list_of_names(field.annotation) else None
            flag = f"--{name.replace('_', '-')}"
            info = typer.Option(
                f"{flag}/--no-{flag[2:]}" if field.annotation is bool else flag,
                help=texts.get(name),
                metavar=named,
                case_sensitive=False,
            )
        default = inspect.Parameter.empty if required else _default(field, kind)
        parameters.append(_keyword(name, Annotated[kind, info], default))
    return sorted(parameters, key=lambda each: each.default is not inspect.Parameter.empty)


def build_spec(spec: type[SpecType], values: dict[str, Any]) -> SpecType:
    """Return the spec of command-line values."""
    given: dict[str, Any] = {}
    for name, field in spec.model_fields.items():
        value = values.get(name)
        if value is None:
            continue
        if _is_list_of_names(field.annotation):  # separated by commas, repeated, or both
            value = [part.strip() for each in value for part in each.split(",") if part.strip()]
        given[name] = value
    try:
        return spec.model_validate(given)
    except ValidationError as error:
        raise InputError(validation_messages(error, spec)) from error


def command_of(
    spec: type[Spec], run: Callable[..., None], common: list[inspect.Parameter] | None
) -> Any:
    """Return a function with a spec's options and the common ones as its signature.

    If `common` is None, it has no options, and can be listed only.
    """

    def command(**values: Any) -> None:
        shared = {each.name: values.pop(each.name) for each in common or ()}
        run(spec, values, **shared)

    parameters = [] if common is None else [*options_of(spec), *common]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__doc__ = help_of(spec)
    return command


def help_of(spec: type[Spec]) -> str:
    """Return the help of a command: docstring and example of its spec."""
    text = inspect.cleandoc(spec.__doc__ or "")
    return f"{text}\n\nExample:\n\n{spec.example}" if spec.example else text


def _default(field: FieldInfo, kind: Any) -> Any:
    value = field.get_default(call_default_factory=True)
    if isinstance(value, tuple) and value and _is_list_of_names(field.annotation):
        return [str(each) for each in value]
    return None if value == () or (value == "" and kind is not bool) else value


def _command_line_type(annotation: Any) -> Any:
    """Return the type that the command line parses; the spec checks limits."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _command_line_type(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        inner = [each for each in get_args(annotation) if each is not type(None)]
        return _command_line_type(inner[0]) | None
    if origin is tuple:
        element = _command_line_type(get_args(annotation)[0])
        return list[Path] if element is Path else list[str]
    plain = origin is Literal or annotation in (int, float, bool, Path)
    return annotation if plain else str | None


def _is_list_of_names(annotation: Any) -> bool:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _is_list_of_names(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return any(_is_list_of_names(each) for each in get_args(annotation))
    return origin is tuple and _command_line_type(get_args(annotation)[0]) is not Path
