"""A plan as an Open Job Description template (jobtemplate-2023-09).

Nothing that a user named stands in the template: tasks are told apart by number and find their
spec in a file of the bundle. So no name, whatever is in it, is ever read as ``{{an expression}}``
or as a part of a command. The job's name goes in as a parameter's value, which is not read either.
"""

from collections.abc import Sequence
from typing import Any

from usdface.core.errors import InputError
from usdface.farm.plan import FarmStep
from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP

TASKS = "tasks"
"""Folder of the bundle: STEP/NUMBER.yaml is the spec of one task."""

LONGEST_JOB_NAME = 128
NOTIFY_SECONDS = 30
"""Between the one SIGTERM a task gets and its end: time to remove what is half written."""


def check_job_name(name: str) -> None:
    """Raise InputError if farms would refuse a job's name."""
    if not name.isprintable() or not name.strip() or len(name) > LONGEST_JOB_NAME:
        raise InputError(
            f"job: {name!r} cannot name a job on a farm; give it 1 to {LONGEST_JOB_NAME} "
            "characters that print"
        )


def job_template(name: str, steps: Sequence[FarmStep]) -> dict[str, Any]:
    """Return the template of a job.

    Parameters
    ----------
    name : str
        The job's; shown on the farm, character by character as it is.

    Raises
    ------
    InputError
        If farms would refuse the name.
    """
    check_job_name(name)
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": "{{Param.Job}}",
        "description": "Facial capture to BlendShape weights. Every task can be retried.",
        "parameterDefinitions": [
            {
                "name": "Job",
                "type": "STRING",
                "description": "The job's name.",
                "default": name,
                "userInterface": {"control": "LINE_EDIT", "label": "Job"},
            },
            {
                "name": "Tasks",
                "type": "PATH",
                "description": "The specs of the tasks, STEP/NUMBER.yaml.",
                "objectType": "DIRECTORY",
                "dataFlow": "IN",
                "default": TASKS,
                "userInterface": {"control": "HIDDEN"},
            },
        ],
        "steps": [_step(step) for step in steps],
    }


def task_command(spec: str) -> list[str]:
    """Return the command line of a task, as arguments.

    Parameters
    ----------
    spec : str
        Path of the task's spec, in whatever form the farm fills it in.
    """
    return ["usdface", "run", spec, "--make-folders", "--progress", "openjd"]


def _step(step: FarmStep) -> dict[str, Any]:
    needs = SPEC_BY_STEP.get(step.kind, Spec)
    command, *arguments = task_command(
        f"{{{{Param.Tasks}}}}/{step.name}/{{{{Task.Param.Task}}}}.yaml"
    )
    written: dict[str, Any] = {"name": step.name}
    if step.needs:
        written["dependencies"] = [{"dependsOn": name} for name in step.needs]
    count = len(step.tasks)
    task = {"name": "Task", "type": "INT", "range": "1" if count == 1 else f"1-{count}"}
    return written | {
        "parameterSpace": {"taskParameterDefinitions": [task]},
        "hostRequirements": {
            "amounts": [
                {"name": "amount.worker.vcpu", "min": needs.cores},
                {"name": "amount.worker.memory", "min": needs.memory_mib},
            ]
        },
        "script": {
            "actions": {
                "onRun": {
                    "command": command,
                    "args": [*arguments, "--path-mapping", "{{Session.PathMappingRulesFile}}"],
                    "cancelation": {
                        "mode": "NOTIFY_THEN_TERMINATE",
                        "notifyPeriodInSeconds": NOTIFY_SECONDS,
                    },
                }
            }
        },
    }
