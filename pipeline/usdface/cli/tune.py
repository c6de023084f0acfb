"""`usdface tune`: serve the tuning page until interrupted."""

import inspect
import json
import webbrowser
from typing import Any

from usdface.cli.console import echo, show_result
from usdface.cli.spec_options import build_spec, command_of
from usdface.core.errors import InputError
from usdface.core.text import pluralize
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.commands import TuneSpec

_NEEDED = ("starlette", "uvicorn", "anyio", "h11")


def tune_command(as_json: inspect.Parameter) -> Any:
    """Return the command, with the common option for JSON."""
    return command_of(TuneSpec, _tune, [as_json])


def _tune(spec_type: type[Spec], values: dict[str, Any], *, as_json: bool) -> None:
    spec = build_spec(TuneSpec, values)
    from usdface.runner.outputs import check_inputs

    check_inputs(spec)
    try:
        from usdface.tuning.serve import serve
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] not in _NEEDED:
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
    show_result(StepResult((session.tuned_path,), summary, tuple(notes), figures), as_json=as_json)
