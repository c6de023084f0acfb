r"""Kitsu: a published version becomes a revision of a shot's task, with sheet and movie to review.

    python publish_to_kitsu.py publish/kitchen.hero/v003 --project Kitchen --sequence SQ01 \
        --shot SH010 --task Facial --status wfa

Where Kitsu is and who asks comes from the environment, never from arguments that others can list:
KITSU_URL (…/api), and KITSU_TOKEN or KITSU_LOGIN with KITSU_PASSWORD.
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import gazu

from usdface.errors import InputError, UsdfaceError
from usdface.publish.integrate import read_manifest

PREVIEWS = ("movie", "sheet")
"""Roles of a version's files that reviewers see, the main one first."""


@dataclass(frozen=True)
class Task:
    """Where in Kitsu a version belongs.

    Attributes
    ----------
    project, sequence, shot : str
        Names.
    task_type : str
        Name of the task's type, such as Facial.
    """

    project: str
    sequence: str
    shot: str
    task_type: str


def connect():
    """Return a client that is logged in as the environment says.

    Raises
    ------
    InputError
        If the environment does not say, or Kitsu refuses.
    """
    url = os.environ.get("KITSU_URL", "")
    token, login = os.environ.get("KITSU_TOKEN"), os.environ.get("KITSU_LOGIN")
    if not url or not (token or login):
        raise InputError(
            "set KITSU_URL, and KITSU_TOKEN or KITSU_LOGIN with KITSU_PASSWORD, in the environment"
        )
    client = gazu.client.create_client(url)
    try:
        if token:
            gazu.set_token(token, client=client)
        else:
            gazu.log_in(login, os.environ.get("KITSU_PASSWORD", ""), client=client)
    except Exception as error:  # whatever the network or the server makes of it
        raise InputError(f"{url}: refuses the login: {type(error).__name__}") from error
    return client


def publish_to_kitsu(folder, task, *, status, client, comment=""):
    """Post a version to a task: status, comment, previews at the version's number.

    A version that is there already is not posted again, so that a publish can be retried.

    Parameters
    ----------
    folder : Path
        A version that `integrate_performance` made.
    task : Task
    status : str
        Short name of the status to set, such as wfa.
    client : gazu.client.KitsuClient
    comment : str

    Returns
    -------
    bool
        Whether anything was posted.

    Raises
    ------
    InputError
        If the version, or anything that `task` names, is not there.
    """
    manifest = read_manifest(folder)
    version = int(manifest["version"])
    found = _find_task(task, client)
    new_status = _named(
        gazu.task.get_task_status_by_short_name(status, client=client), "status", status
    )
    there = gazu.task.all_previews_for_task(found, client=client)
    if any(preview.get("revision") == version for preview in there):
        return False
    text = f"{manifest['name']} v{version:03}: {comment or manifest.get('comment') or 'published'}"
    files = [
        folder / manifest["files"][role]["name"] for role in PREVIEWS if role in manifest["files"]
    ]
    posted = gazu.task.add_comment(found, new_status, comment=text, client=client)
    main = None
    for file in files:
        if main is None:
            main = gazu.task.add_preview(
                found, posted, preview_file_path=str(file), revision=version, client=client
            )
            gazu.task.set_main_preview(main, client=client)
        else:
            gazu.task.add_extra_preview(
                found, posted, main, preview_file_path=str(file), client=client
            )
    return True


def _find_task(task, client):
    project = _named(
        gazu.project.get_project_by_name(task.project, client=client), "project", task.project
    )
    sequence = _named(
        gazu.shot.get_sequence_by_name(project, task.sequence, client=client),
        "sequence",
        task.sequence,
    )
    shot = _named(gazu.shot.get_shot_by_name(sequence, task.shot, client=client), "shot", task.shot)
    kind = _named(
        gazu.task.get_task_type_by_name(task.task_type, client=client), "task type", task.task_type
    )
    return _named(
        gazu.task.get_task_by_entity(shot, kind, client=client),
        "task",
        f"{task.task_type} of {task.shot}",
    )


def _named(found, what, name):
    if not found:
        raise InputError(f"Kitsu: there is no {what} {name!r}; check the name, or make it first")
    return found


def main(arguments=None):
    """Run from the command line; the exit code is usdface's: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("version", type=Path, help="folder of a published version")
    for name in ("project", "sequence", "shot", "task", "status"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--comment", default="")
    given = parser.parse_args(arguments)
    try:
        posted = publish_to_kitsu(
            given.version,
            Task(given.project, given.sequence, given.shot, given.task),
            status=given.status,
            client=connect(),
            comment=given.comment,
        )
    except UsdfaceError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    sys.stdout.write("posted\n" if posted else "is there already\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
