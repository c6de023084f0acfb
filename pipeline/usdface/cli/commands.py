"""Commands that no spec generates.

Of jobs: run, check, demo, completion. Of files, whose content they print: describe, names,
validate, edits list.
"""

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from usdface.cli.console import echo, progress_listener, show_json, show_result
from usdface.cli.spec_options import Json, Overwrite, ShowProgress
from usdface.core.confinement import ROOT_VARIABLE, check_confined
from usdface.core.errors import InputError
from usdface.specs.job import JobSpec
from usdface.specs.paths import read_path_rules
from usdface.specs.reading import read_job
from usdface.specs.review import VerdictLevel

COMPLETE_VARIABLE = "_USDFACE_COMPLETE"
"""Environment variable that shells set to request completions."""

Root = Annotated[
    Path | None,
    typer.Option(
        envvar=ROOT_VARIABLE, help="Refuse jobs that read or write files outside this folder."
    ),
]


def run(
    job: Annotated[Path, typer.Argument(help="Job file, YAML or JSON.", show_default=False)],
    progress: ShowProgress = "auto",
    overwrite: Overwrite = False,
    as_json: Json = False,
    path_mapping: Annotated[
        Path | None, typer.Option(help="Path mapping rules of a farm (JSON, pathmapping-1.0).")
    ] = None,
    with_folders: Annotated[
        bool, typer.Option("--make-folders", help="Create the folders of the job's outputs.")
    ] = False,
    notes: Annotated[
        bool, typer.Option("--notes", help="Print the notes of steps that are up to date, too.")
    ] = False,
    root: Root = None,
) -> None:
    """Run the steps of a job whose outputs are missing or out of date.

    The result and notes of each step are printed when it ends.

    Example:

    usdface run kitchen.job.yaml
    """
    from usdface.cli.run import run_and_show
    from usdface.runner.job import make_folders

    spec = read_job(job, path_rules=() if path_mapping is None else read_path_rules(path_mapping))
    _confine(spec, root)
    if with_folders:
        make_folders(spec)
    run_and_show(spec, job, style=progress, overwrite=overwrite, as_json=as_json, again=notes)


def check(
    job: Annotated[Path, typer.Argument(help="Job file, YAML or JSON.", show_default=False)],
    as_json: Json = False,
    root: Root = None,
) -> None:
    """Validate a job without running it, and list the steps that would run.

    Example:

    usdface check kitchen.job.yaml
    """
    from usdface.runner.state import job_states

    spec = read_job(job)
    _confine(spec, root)
    states = job_states(spec)
    if as_json:
        show_json([{"step": s.spec.step, "state": s.state, "reason": s.reason} for s in states])
        return
    for number, state in enumerate(states, start=1):
        echo(f"{number}. {state.spec.step}: {state.state} ({state.reason})")


def demo(
    out_folder: Annotated[
        Path, typer.Option("--out", help="Folder of the demo.", show_default=False)
    ],
    dog: Annotated[
        bool,
        typer.Option(
            "--dog",
            help="Instead, retarget a performance to a dog of 28 shapes, 8 joints and 36 float "
            "controls, and warp it to keyed sequences.",
        ),
    ] = False,
    source: Annotated[
        Literal["markers", "video"],
        typer.Option(
            "--from", help="`video` tracks the face in the actor's clip instead of using markers."
        ),
    ] = "markers",
    model: Annotated[
        Path | None,
        typer.Option(
            help="With --from video: the face landmark model of `usdface track`. Default: the "
            "file that the environment variable USDFACE_FACE_MODEL names.",
            show_default=False,
        ),
    ] = None,
    video_lines: Annotated[
        Literal["240", "480", "720"],
        typer.Option(
            help="Height of the actor's clip in pixels; at 720, typical of phones, rendering it "
            "takes minutes."
        ),
    ] = "240",
    progress: ShowProgress = "auto",
    as_json: Json = False,
) -> None:
    """Generate a character, an actor and a take, and run a job from capture to report.

    The job file stays in the folder and can be changed and run again.

    Example:

    usdface demo --out demo
    """
    from usdface.cli.run import showing_events
    from usdface.demo import DOG_JOB_NAME, JOB_NAME

    model = _demo_model(dog, source, model, video_lines)
    # On stderr, as stdout may be JSON; before the imports, which take a second or two.
    typer.echo(f"making a demo in {out_folder}; this takes half a minute to a minute", err=True)
    with progress_listener(progress) as listener:
        job = out_folder / (DOG_JOB_NAME if dog else JOB_NAME)
        events = showing_events(job, [], style=progress, as_json=as_json)
        if dog:
            from usdface.demo.dog_job import run_dog_demo

            report = run_dog_demo(out_folder, progress=listener, events=events)
        else:
            from usdface.demo.job import run_demo

            report = run_demo(
                out_folder,
                model=model,
                video_lines=int(video_lines),
                progress=listener,
                events=events,
            )
    show_result(report, as_json=as_json)


def completion(
    shell: Annotated[
        Literal["bash", "zsh", "fish"], typer.Argument(help="Your shell.", show_default=False)
    ],
) -> None:
    """Print a script with which a shell completes commands, options and values.

    bash: add the line below to ~/.bashrc; zsh: to ~/.zshrc, with zsh in place of bash. fish:
    usdface completion fish > ~/.config/fish/completions/usdface.fish

    Example:

    eval "$(usdface completion bash)"
    """
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    echo(get_completion_script(prog_name="usdface", complete_var=COMPLETE_VARIABLE, shell=shell))


def _confine(job: JobSpec, root: Path | None) -> None:
    """Refuse paths outside a root, now and in every step of the job."""
    if root is not None:
        os.environ[ROOT_VARIABLE] = str(root.resolve())
        check_confined(job.named_paths(), root)


def _demo_model(dog: bool, source: str, model: Path | None, video_lines: str) -> Path | None:
    """Return the model for tracking, None without tracking; refuse options without effect."""
    if dog and (source == "video" or model is not None):
        raise InputError("--from and --model have no effect with --dog; leave them out")
    if dog and video_lines != "240":
        raise InputError("--video-lines has no effect with --dog; leave it out")
    if source == "video":
        from usdface.capture.face_landmarker import named_model

        return named_model(model)
    if model is not None:
        raise InputError("--model has no effect without --from video; leave it out")
    return None


def describe(
    mapping: Annotated[
        Path, typer.Argument(help="A trained mapping or retargeting.", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Print the method, settings and cross-validation scores of a mapping.

    The first line is the share of the markers' variance in the principal components.

    Example:

    usdface describe hero.mapping.usdc
    """
    from usdface.steps.performance.describe import describe_mapping

    show_result(describe_mapping(mapping), as_json=as_json)


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
    prim: Annotated[
        list[str] | None,
        typer.Option(help="Face of the rig; given again, of the source. Needed among several."),
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
    from usdface.steps.retarget.pairs_propose import list_names

    if len(prims := tuple(prim or ())) > 2:
        raise InputError(f"--prim {prims[2]}: the rig and the source have a face each")
    report = list_names(
        rig, source, prims=prims, names=table, by=match, out=out, overwrite=overwrite
    )
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
        str | None, typer.Option(help="Face, if the layer holds several.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """List the edits of a performance, and where the solve has changed since they were made.

    Example:

    usdface edits list kitchen.hero.usda
    """
    from usdface.steps.edits.list_ import list_edit_ranges

    show_result(list_edit_ranges(performance, prim=prim), as_json=as_json)
