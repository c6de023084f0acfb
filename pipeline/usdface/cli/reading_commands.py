"""Commands that read files and print a result: describe, names, validate, edits list."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from usdface.cli.console import show_json, show_result
from usdface.cli.spec_options import Json, Overwrite
from usdface.specs.review import VerdictLevel


def describe(
    mapping: Annotated[
        Path, typer.Argument(help="A trained mapping or retargeting.", show_default=False)
    ],
    picture: Annotated[
        Path | None,
        typer.Option(
            help="Picture to write of the eigen-space: takes and references along the first "
            "principal components."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the method, settings and cross-validation scores of a mapping.

    The first line is the share of the markers' variance in the principal components.

    Example:

    usdface describe hero.mapping.usdc
    """
    from usdface.steps.performance.describe import describe_mapping

    show_result(describe_mapping(mapping, picture=picture), as_json=as_json)


def names(
    rig: Annotated[Path, typer.Argument(help="The rig to drive.", show_default=False)],
    source: Annotated[
        Path | None,
        typer.Argument(
            help="A rig, a take, a performance, or a capture or table of weights. Default: the 52 "
            "names of ARKit.",
            show_default=False,
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--names", help="Edited table to use instead.", show_default=False),
    ] = None,
    match: Annotated[
        Literal["both", "name", "deformation"],
        typer.Option(help="Between rigs: match by name, by deformation, or by both."),
    ] = "both",
    out: Annotated[
        Path | None,
        typer.Option(help="Write the table, .csv or .json, to be edited.", show_default=False),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Print which shapes of a source drive which shapes of a rig, by the meaning of their names.

    Names of ARKit, ICT, Character Creator, MetaHuman, FACS, Meta, MPFB, FACEGOOD and VRoid are
    recognised, with any prefix, suffix and side. Ambiguous names are listed, not matched. Write the
    table with --out, edit it, and give it to `retarget --names`, `pairs propose --names` or
    `references import --names`.

    Example:

    usdface names hero.usd kitchen.take.usda --out kitchen.names.csv
    """
    from usdface.steps.retarget.names import list_names

    report = list_names(rig, source, names=table, by=match, out=out, overwrite=overwrite)
    if as_json:
        show_json(report.as_data() | {"pairs": report.figures["pairs"]})
    else:
        show_result(report, as_json=False)


def validate(
    layers: Annotated[list[Path], typer.Argument(help="USD layers to check.", show_default=False)],
    worst_verdict: Annotated[
        VerdictLevel | None,
        typer.Option(
            help="Worst verdict on a solve that is accepted. Default: that of the environment "
            "variable USDFACE_WORST_VERDICT, else check.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check USD layers with the validators of USD and usdface, and by the verdict on solves.

    Each finding states a fix. Exit code 1 if there is an error, 0 if there are only warnings.

    Example:

    usdface validate kitchen.take.usda kitchen.hero.usda
    """
    from usdface.steps.edits.validate import validate_layers

    report = validate_layers(tuple(layers), worst_verdict=worst_verdict)
    show_result(report, as_json=as_json)
    report.require_success()


def list_edits(
    performance: Annotated[Path, typer.Argument(help="An edited performance.", show_default=False)],
    prim: Annotated[
        str | None,
        typer.Option(help="Face, if the layer holds several.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the edits of a performance, and where the solve has changed since they were made.

    Example:

    usdface edits list kitchen.hero.usda
    """
    from usdface.steps.edits.list_ import list_edit_ranges

    show_result(list_edit_ranges(performance, prim=prim), as_json=as_json)
