"""Commands generated from the specs of steps."""

import inspect
import json
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from usdface.cli.command_list import EPILOG, CommandList
from usdface.cli.console import ProgressStyle, echo, progress_listener, show_result
from usdface.cli.spec_options import COMMON_OPTIONS, build_spec, command_of
from usdface.core.errors import CancelledError, InputError
from usdface.core.progress import Progress
from usdface.core.replacing import write_new_text
from usdface.core.text import first_few, pluralize
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.capture import IngestSpec
from usdface.specs.commands import SubmitSpec, TuneSpec
from usdface.specs.job import COMMAND_SPECS
from usdface.specs.reading import spec_text
from usdface.specs.retarget import RetargetSpec

_TUNE_NEEDS = ("starlette", "uvicorn", "anyio", "h11")


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
        write_new_text(save_spec, text)
        echo(f"wrote {save_spec}")
        return
    from usdface.runner.execute import execute

    with progress_listener(progress) as listener:
        report = execute(spec, overwrite=overwrite, progress=listener)
    show_result(report, as_json=as_json)


def _folder_of_takes(spec_type: type[Spec], values: dict[str, Any]) -> Path | None:
    """Return the source of `ingest` or `retarget` if it is a folder."""
    if spec_type not in (IngestSpec, RetargetSpec):
        return None
    given = values.get("sources" if spec_type is IngestSpec else "source")
    sources = given if isinstance(given, list | tuple) else [given]
    return sources[0] if len(sources) == 1 and sources[0] and sources[0].is_dir() else None


def _run_folder(
    spec_type: type[Spec], values: dict[str, Any], folder: Path, overwrite: bool, progress: Progress
) -> StepResult:
    if spec_type is IngestSpec:
        from usdface.steps.capture.ingest_folder import ingest_folder

        target = values.pop("out")
        ingest = build_spec(IngestSpec, values | {"out": target / "all.take.usda"})
        return ingest_folder(folder, target, ingest, overwrite=overwrite, progress=progress)
    from usdface.steps.retarget.retarget_folder import retarget_folder

    outs = list(values.pop("out"))
    if len(outs) != 1:
        raise InputError(f"{folder}: is a folder, whose takes are written to one; give one --out")
    count = max(len(values.get(name) or ()) for name in ("retargeting", "rig"))
    names = tuple(outs[0] / f"all{index}.usda" for index in range(count))
    shared = build_spec(RetargetSpec, values | {"out": names})
    return retarget_folder(folder, outs[0], shared, overwrite=overwrite, progress=progress)


def _submit(
    spec_type: type[SubmitSpec], values: dict[str, Any], *, overwrite: bool, as_json: bool
) -> None:
    from usdface.farm.submit import describe, submit

    spec = build_spec(spec_type, values)
    done = submit(spec, overwrite=overwrite, quiet=as_json)
    notes: tuple[str, ...] = ()
    if unsplit := [path.name for path in done.plan.whole]:
        notes = (
            f"not split into chunks: {first_few(unsplit, most=3)}; the number of frames is known "
            "only after ingest, so set `frames` in the job",
        )
    tasks = {step.name: len(step.tasks) for step in done.plan.steps}
    verb = "written" if spec.write_only else "done" if spec.farm == "openjd" else "submitted"
    summary = f"{done.job}: {pluralize(sum(tasks.values()), 'task')}, {verb}"
    report = StepResult(
        (done.bundle,), summary, notes, {"job": done.job, "tasks": tasks}, describe(done)
    )
    show_result(report, as_json=as_json)


def _tune(spec_type: type[Spec], values: dict[str, Any], *, as_json: bool) -> None:
    spec = build_spec(TuneSpec, values)
    from usdface.runner.outputs import check_inputs

    check_inputs(spec)
    try:
        from usdface.tuning.serve import serve
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] not in _TUNE_NEEDS:
            raise
        raise InputError(
            f"the tuning page needs {error.name}, which is not installed: "
            "pip install 'usdface[tune]'"
        ) from error
    links = list[str]()

    def announce(link: str) -> None:
        if as_json:
            echo(json.dumps({"link": link}))
        else:
            echo(f"{'tune at' if not links else 'new link:'} {link}")
            if not links:
                echo("  Ctrl+C saves and exits; the link works once, for one browser")
        if spec.browser and not links:
            webbrowser.open(link)
        links.append(link)

    session = serve(spec, announce=announce)
    state = session.state()
    count = len(state.tuned)
    figures: dict[str, object] = {
        "pairs": count,
        "tuned": int(state.tuned.sum()),
        "done": int(state.done.sum()),
        "recovered": session.recovered,
    }
    summary = f"{figures['tuned']} of {pluralize(count, 'pair')} tuned, {figures['done']} done"
    notes = list[str]()
    if session.recovered:
        changes = pluralize(session.recovered, "change")
        notes.append(f"recovered from a crashed session: {changes}")
    if (before := session.lock.taken_from) is not None:
        notes.append(
            f"lock taken over from {before.user} on {before.host}, held since {before.since}"
        )
    pictures: tuple[Path, ...] = ()
    if figures["tuned"] != int(session.references.tuned.sum()):
        pictures, picture_notes = _redraw_coverage(spec, as_json=as_json)
        notes += picture_notes
    files = (session.tuned_path, *pictures)
    show_result(StepResult(files, summary, tuple(notes), figures), as_json=as_json)


def _redraw_coverage(spec: TuneSpec, *, as_json: bool) -> tuple[tuple[Path, ...], list[str]]:
    """Draw the coverage of tuned references again, after the page has been closed."""
    from usdface.steps.references.coverage import redraw_coverage
    from usdface.usdio.rig.reference import moved_rig

    try:
        with moved_rig(spec.rig), progress_listener("none" if as_json else "auto") as listener:
            return redraw_coverage(spec.references, listener)
    except (KeyboardInterrupt, CancelledError):
        return (), ["interrupted: the picture of the coverage was not drawn again"]


GROUPS = {
    "references": (
        "references",
        "Import tuned weights and edits into references, measure and draw them.",
    ),
    "pairs": ("retarget", "Make pairs of corresponding expressions of two characters."),
    "edits": ("edits", "Import edits from a DCC, or list the edits of a performance."),
}
"""Groups of commands: workflow and summary."""


def add_step_commands(
    app: typer.Typer, only: str | None = None, *, listed: bool = False
) -> dict[str, typer.Typer]:
    """Add the commands of all specs; return the groups, of steps named ``GROUP-...``.

    Parameters
    ----------
    only : str, optional
        The one command or group to add.
    listed : bool
        Whether the commands are listed, for which they need no options.
    """
    groups = {
        name: typer.Typer(
            cls=CommandList, help=summary, no_args_is_help=True, rich_markup_mode=None
        )
        for name, (_, summary) in GROUPS.items()
        if only in (None, name)
    }

    def add(spec: type[Spec], run: Callable[..., None], common: list[inspect.Parameter]) -> None:
        group, _, rest = spec.step_name().partition("-")
        to, name = (groups.get(group), rest) if group in GROUPS else (app, spec.step_name())
        if to is None or (to is app and only not in (None, name)):
            return
        function = command_of(spec, run, None if listed else common)
        to.command(name, epilog=EPILOG, rich_help_panel=spec.workflow())(function)

    for spec in COMMAND_SPECS:
        add(spec, _run_step, COMMON_OPTIONS)
    add(TuneSpec, _tune, _shared("as_json"))
    add(SubmitSpec, _submit, _shared("overwrite", "as_json"))
    for name, made in groups.items():
        app.add_typer(made, name=name, rich_help_panel=GROUPS[name][0])
    return groups


def _shared(*names: str) -> list[inspect.Parameter]:
    """Return some of the common options."""
    return [each for each in COMMON_OPTIONS if each.name in names]
