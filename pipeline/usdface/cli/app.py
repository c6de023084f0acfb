"""All commands: those of steps are generated from their specs, the others are written here."""

import contextlib
import inspect
import os
import sys
import traceback
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

from usdface.cli.command_list import EPILOG, CommandMaker, commands_on_demand
from usdface.cli.console import (
    ProgressStyle,
    echo,
    exit_code_of,
    progress_listener,
    raise_on_signals,
    set_up_logging,
    show_error,
    show_json,
    show_result,
)
from usdface.cli.spec_options import build_spec, command_of, help_of
from usdface.cli.tune import tune_command
from usdface.core.confinement import ROOT_VARIABLE, check_confined
from usdface.core.errors import CheckFailedError, InputError, UsdfaceError
from usdface.core.progress import Progress
from usdface.core.replacing import creating
from usdface.core.text import first_few, pluralize
from usdface.core.version import __version__
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.capture import IngestSpec
from usdface.specs.commands import SubmitSpec, TuneSpec
from usdface.specs.job import COMMAND_SPECS, JobSpec
from usdface.specs.paths import read_path_rules
from usdface.specs.reading import read_job, spec_text
from usdface.specs.retarget import RetargetSpec

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
        "--overwrite", help="Replace existing outputs, including newer files and files of others."
    ),
]
SaveSpec = Annotated[
    Path | None,
    typer.Option(
        "--save-spec", help="Write the spec of this command to a new file, without running it."
    ),
]


_COMPLETE = "_USDFACE_COMPLETE"
"""Environment variable by which a shell asks for completions."""

Root = Annotated[
    Path | None,
    typer.Option(
        envvar=ROOT_VARIABLE, help="Refuse jobs that read or write files outside this folder."
    ),
]


def _confine(job: JobSpec, root: Path | None) -> None:
    """Refuse paths outside a root, for this job and for every step that it runs."""
    if root is not None:
        os.environ[ROOT_VARIABLE] = str(root.resolve())
        check_confined(job.named_paths(), root)


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


COMMON = [
    _keyword("overwrite", Overwrite, False),
    _keyword("save_spec", SaveSpec, None),
    _keyword("progress", ShowProgress, "auto"),
    _keyword("as_json", Json, False),
]
_SUBMIT_COMMON = ("overwrite", "as_json")


def _run_step(
    spec_type: type[Spec],
    values: dict[str, Any],
    *,
    overwrite: bool,
    save_spec: Path | None,
    progress: ProgressStyle,
    as_json: bool,
) -> None:
    folder = _folder_of_takes(spec_type, values)
    if folder is not None:
        if save_spec is not None:
            raise InputError(
                f"{folder}: --save-spec writes the spec of one take; name a take's files instead "
                "of a folder, or leave it out"
            )
        with progress_listener(progress) as listener:
            report = _run_folder(spec_type, values, folder, overwrite, listener)
        show_result(report, as_json=as_json)
        return
    spec = build_spec(spec_type, values)
    if save_spec is not None:
        text = spec_text(spec.relative_to(save_spec.parent), save_spec)
        with creating(save_spec) as temporary:
            temporary.write_text(text, encoding="utf-8")
        echo(f"wrote {save_spec}")
        return
    from usdface.runner.execute import execute

    with progress_listener(progress) as listener:
        report = execute(spec, overwrite=overwrite, progress=listener)
    show_result(report, as_json=as_json)
    report.require_success()


def _folder_of_takes(spec_type: type[Spec], values: dict[str, Any]) -> Path | None:
    """Return the folder that `ingest` or `retarget` is pointed at, if it is one."""
    if spec_type not in (IngestSpec, RetargetSpec):
        return None
    given = values.get("sources" if spec_type is IngestSpec else "source")
    sources = given if isinstance(given, list | tuple) else [given]
    return sources[0] if len(sources) == 1 and sources[0] and sources[0].is_dir() else None


def _run_folder(
    spec_type: type[Spec],
    values: dict[str, Any],
    folder: Path,
    overwrite: bool,
    progress: Progress,
) -> StepResult:
    if spec_type is IngestSpec:
        from usdface.steps.capture.ingest_folder import ingest_folder

        target = values.pop("out")
        ingest = build_spec(IngestSpec, values | {"out": target / "all.take.usda"})
        return ingest_folder(folder, target, ingest, overwrite=overwrite, progress=progress)
    from usdface.steps.retarget.retarget_folder import retarget_folder

    outs = list(values.pop("out"))
    if len(outs) != 1:
        raise InputError(f"{folder}: is a folder, so one folder is written; give one --out")
    count = max(len(values.get(name) or ()) for name in ("retargeting", "rig"))
    names = tuple(outs[0] / f"all{index}.usda" for index in range(count))
    shared = build_spec(RetargetSpec, values | {"out": names})
    return retarget_folder(folder, outs[0], shared, overwrite=overwrite, progress=progress)


def _unchunked_notes(names: list[str]) -> tuple[str, ...]:
    if not names:
        return ()
    return (
        f"not split into chunks: {first_few(names, most=3)}; the number of frames is known only "
        "after ingest, so set `frames` in the job",
    )


def _submit(
    spec_type: type[SubmitSpec],
    values: dict[str, Any],
    *,
    overwrite: bool,
    as_json: bool,
) -> None:
    from usdface.farm.submit import describe, submit

    spec = build_spec(spec_type, values)
    done = submit(spec, overwrite=overwrite, quiet=as_json)
    notes = _unchunked_notes([path.name for path in done.plan.whole])
    tasks = {step.name: len(step.tasks) for step in done.plan.steps}
    verb = "written" if spec.write_only else "done" if spec.farm == "openjd" else "submitted"
    summary = f"{done.job}: {pluralize(sum(tasks.values()), 'task')}, {verb}"
    report = StepResult(
        (done.bundle,), summary, notes, {"job": done.job, "tasks": tasks}, describe(done)
    )
    show_result(report, as_json=as_json)


_GROUPS = {
    "references": (
        "references",
        "Import tuned weights and edits into references, measure and draw them.",
    ),
    "pairs": ("retarget", "Make pairs of corresponding expressions of two characters."),
    "edits": ("edits", "Import edits from a DCC, or list the edits of a performance."),
}
"""Groups of commands: the workflow each is listed under, and its summary."""


def _step_maker(spec: type[Spec]) -> CommandMaker:
    make = partial(command_of, spec, _run_step, COMMON)
    return CommandMaker(make, help_of(spec), spec.workflow())


def _make_group(group: str) -> typer.Typer:
    """Return a group with the commands of the steps whose names begin with its own."""
    makers = {
        spec.step_name().removeprefix(f"{group}-"): _step_maker(spec)
        for spec in COMMAND_SPECS
        if spec.step_name().startswith(f"{group}-")
    }
    workflow, summary = _GROUPS[group]
    made = typer.Typer(
        cls=commands_on_demand(makers), help=summary, no_args_is_help=True, rich_markup_mode=None
    )
    made.info.rich_help_panel = workflow  # the constructor drops it
    return made


def _top_commands() -> dict[str, CommandMaker]:
    """Return what makes each command of the top; a group stands where its first command would."""
    makers: dict[str, CommandMaker] = {}
    for spec in COMMAND_SPECS:
        group = spec.step_name().partition("-")[0]
        if group in _GROUPS:
            workflow, summary = _GROUPS[group]
            makers[group] = CommandMaker(partial(_groups.__getitem__, group), summary, workflow)
        else:
            makers[spec.step_name()] = _step_maker(spec)
    shared = [each for each in COMMON if each.name in _SUBMIT_COMMON]
    return makers | {
        "tune": CommandMaker(
            partial(tune_command, COMMON[-1]), help_of(TuneSpec), TuneSpec.workflow()
        ),
        "submit": CommandMaker(
            partial(command_of, SubmitSpec, _submit, shared),
            help_of(SubmitSpec),
            SubmitSpec.workflow(),
        ),
    }


_groups = {group: _make_group(group) for group in _GROUPS}
app = typer.Typer(
    name="usdface",
    cls=commands_on_demand(_top_commands()),
    help="Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline.",
    epilog=EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@_groups["edits"].command("list", epilog=EPILOG)
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


@app.command(epilog=EPILOG, rich_help_panel="jobs")
def run(
    job: Annotated[Path, typer.Argument(help="Job file, YAML or JSON.", show_default=False)],
    progress: ShowProgress = "auto",
    overwrite: Overwrite = False,
    as_json: Json = False,
    path_mapping: Annotated[
        Path | None,
        typer.Option(help="Path mapping rules of a farm (JSON, pathmapping-1.0)."),
    ] = None,
    with_folders: Annotated[
        bool, typer.Option("--make-folders", help="Create the folders of the job's outputs.")
    ] = False,
    notes: Annotated[
        bool,
        typer.Option("--notes", help="Print the notes of steps that are up to date, too."),
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


@app.command(epilog=EPILOG, rich_help_panel="jobs")
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


@app.command(epilog=EPILOG, rich_help_panel="performance")
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

    The first line is the share of the markers' variance that principal components hold.

    Example:

    usdface describe hero.mapping.usdc
    """
    from usdface.steps.performance.describe import describe_mapping

    show_result(describe_mapping(mapping, picture=picture), as_json=as_json)


@app.command(epilog=EPILOG, rich_help_panel="retarget")
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
        typer.Option("--names", help="Table to follow instead: an edited one.", show_default=False),
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
    """Print which shapes of a source drive which shapes of a rig, by what their names mean.

    Names of ARKit, ICT, Character Creator, MetaHuman, FACS, Meta, MPFB, FACEGOOD and VRoid are
    understood, with any prefix, suffix and side. What could be either of two is named, not guessed.
    Write the table with --out, edit it, and give it to `retarget --names`, `pairs propose --names`
    or `references import --names`.

    Example:

    usdface names hero.usd kitchen.take.usda --out kitchen.names.csv
    """
    from usdface.steps.retarget.names import list_names

    report = list_names(rig, source, names=table, by=match, out=out, overwrite=overwrite)
    if as_json:
        show_json(report.as_data() | {"pairs": report.figures["pairs"]})
    else:
        show_result(report, as_json=False)


@app.command(epilog=EPILOG, rich_help_panel="edits")
def validate(
    layers: Annotated[list[Path], typer.Argument(help="USD layers to check.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Check USD layers with the validators of USD and usdface.

    Each finding says how to fix it. Exit code 1 if there is an error, 0 if there are only warnings.

    Example:

    usdface validate kitchen.take.usda kitchen.hero.usda
    """
    from usdface.steps.edits.validate import validate_layers

    report = validate_layers(tuple(layers))
    show_result(report, as_json=as_json)
    report.require_success()


@app.command(epilog=EPILOG, rich_help_panel="jobs")
def demo(
    out_folder: Annotated[
        Path, typer.Option("--out", help="Folder of the demo.", show_default=False)
    ],
    dog: Annotated[
        bool,
        typer.Option(
            "--dog",
            help="Retarget a performance to a dog of 28 shapes, 8 joints and 36 float controls "
            "instead, and put its own animation in.",
        ),
    ] = False,
    source: Annotated[
        Literal["markers", "video"],
        typer.Option(
            "--from", help="`video` tracks the actor's face in the clip, and uses no markers."
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
    progress: ShowProgress = "auto",
    as_json: Json = False,
) -> None:
    """Generate a character, an actor and a take, and run a job from capture to report.

    All inputs are generated. The job file stays in the folder, to be changed and run again.

    Example:

    usdface demo --out demo
    """
    from usdface.cli.run import demo_events

    if dog and (source == "video" or model is not None):
        raise InputError("--dog retargets a performance, and tracks nothing; leave --from out")
    if source == "markers" and model is not None:
        raise InputError("--model is of --from video; leave it out")
    if source == "video":
        from usdface.capture.face_landmarker import named_model

        model = named_model(model)
    # On stderr, as stdout may be JSON; before the imports, which take a second or two.
    typer.echo(f"making a demo in {out_folder}; it takes a minute or so", err=True)
    with progress_listener(progress) as listener:
        events = demo_events(progress, as_json=as_json)
        if dog:
            from usdface.demo.dog_job import run_dog_demo

            report = run_dog_demo(out_folder, progress=listener, events=events)
        else:
            from usdface.demo.job import run_demo

            report = run_demo(out_folder, model=model, progress=listener, events=events)
    show_result(report, as_json=as_json)


@app.command(epilog=EPILOG, rich_help_panel="jobs")
def completion(
    shell: Annotated[
        Literal["bash", "zsh", "fish"], typer.Argument(help="Your shell.", show_default=False)
    ],
) -> None:
    """Print what makes a shell complete commands, options and values.

    bash: add the line below to ~/.bashrc, with zsh for bash to ~/.zshrc. fish: usdface completion
    fish > ~/.config/fish/completions/usdface.fish

    Example:

    eval "$(usdface completion bash)"
    """
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    echo(get_completion_script(prog_name="usdface", complete_var=_COMPLETE, shell=shell))


def _version(wanted: bool) -> None:
    if wanted:
        echo(f"usdface {__version__}")
        raise typer.Exit


@app.callback()
def _top(
    verbose: Annotated[
        bool,
        typer.Option("--verbose", help="Log progress, and print tracebacks of internal errors."),
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    set_up_logging(verbose=verbose)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    raise_on_signals()
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["help"]:
        given = [*given[1:], "--help"]
    if _COMPLETE in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()  # Typer does so only for apps that install completion themselves
    as_json = "--json" in given
    try:
        # Otherwise errors of usage are printed and end the process where they are found.
        code = app(args=given, standalone_mode=not as_json)
    except (UsdfaceError, KeyboardInterrupt) as error:
        shown = isinstance(error, CheckFailedError)  # as the failures of a result
        _fail(str(error) or "interrupted", exit_code_of(error), as_json=as_json and not shown)
    except Exception as error:
        if as_json and hasattr(error, "format_message"):  # of usage, of either kind of click
            _fail(error.format_message(), getattr(error, "exit_code", 2), as_json=True)
        if "--verbose" in given:
            traceback.print_exc()
        _fail(
            f"internal error: {type(error).__name__}: {error}\n"
            "No partly written files remain. Please report it with the output of "
            "`usdface --verbose` and the same arguments.",
            exit_code_of(error),
            as_json=as_json,
        )
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int, *, as_json: bool) -> NoReturn:
    """Print an error, for a script as JSON on stdout too, and exit."""
    if as_json:
        with contextlib.suppress(UsdfaceError):  # the error may be that nothing can be printed
            show_json({"error": message, "exit_code": code})
    show_error(message)
    sys.exit(code)
