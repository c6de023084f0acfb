r"""Kitsu: post a published version to a shot's task as a revision, with sheet and movie.

    python publish_to_kitsu.py publish/kitchen.hero/v003 --project Kitchen --sequence SQ01 \
        --shot SH010 --task Facial --status wfa

Address and login come from the environment, because arguments are visible to other users: KITSU_URL
(…/api), and KITSU_TOKEN or KITSU_LOGIN with KITSU_PASSWORD.
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import gazu

from usdface.core.errors import InputError, UsdfaceError
from usdface.publish.integrate import read_manifest
from usdface.specs.notes import read_notes

PREVIEWS = ("movie", "sheet")
"""Roles of the uploaded files, the main preview first."""


@dataclass(frozen=True)
class Task:
    """Names of a task in Kitsu."""

    project: str
    sequence: str
    shot: str
    task_type: str
    """Such as Facial."""


def connect():
    """Return a client that is logged in by the environment's variables."""
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
    except Exception as error:  # of the network or the server
        raise InputError(f"{url}: refuses the login: {type(error).__name__}") from error
    return client


def publish_to_kitsu(folder, task, *, status, client, comment="", notes=None):
    """Post a version to a task: status, comment, and previews with the version's number.

    Can be retried: an existing comment is found by the version it names, and only missing previews
    are added.

    Parameters
    ----------
    folder : Path
        A version made by `integrate_performance`.
    task : Task
    status : str
        Short name of the status to set, such as wfa.
    client : gazu.client.KitsuClient
    comment : str
    notes : Path, optional
        Notes saved by a report; open ones follow the comment, one per line.

    Returns
    -------
    bool
        Whether anything was posted.

    Raises
    ------
    InputError
        If the version, or a name of `task`, does not exist.
    """
    named, version, described, verdict, files = _read_version(folder)
    found = _find_task(task, client)
    new_status = _named(
        gazu.task.get_task_status_by_short_name(status, client=client), "status", status
    )
    start = f"{named} v{version:03}: "
    posted = _comment_that_starts(start, found, client)
    is_new = posted is None
    if is_new:
        text = start + "\n".join([comment or described or "published", *verdict, *_lines(notes)])
        posted = gazu.task.add_comment(found, new_status, comment=text, client=client)
    return _add_missing_previews(files, found, posted, version, client) or is_new


def _read_version(folder):
    """Return a version's name, number, comment, verdict, and existing files to upload."""
    manifest = read_manifest(folder)
    named, version = manifest.get("name"), manifest.get("version")
    if not isinstance(named, str) or type(version) is not int:
        raise InputError(f"{folder}: its publish.json lacks a name or a version; publish again")
    files = []
    for role in PREVIEWS:
        if role in manifest["files"]:
            name = manifest["files"][role].get("name")
            # Only files in the version's folder are uploaded, whatever the manifest names.
            file = folder / Path(name).name if isinstance(name, str) else folder
            if not file.is_file():
                raise InputError(f"{folder}: the {role} {name!r} is not in it; publish again")
            files.append(file)
    verdict = manifest.get("verdict")
    verdict = [str(verdict.get("sentence"))] if isinstance(verdict, dict) else []
    return named, version, str(manifest.get("comment") or ""), verdict, files


def _lines(notes):
    """Return the open notes as lines of a comment; those on another version are marked."""
    if notes is None:
        return []
    found = [note for note in read_notes(notes).notes if not note.done]
    newest = found and max(found, key=lambda note: note.made).version
    return [
        f"- {note.sentence()}{'' if note.version == newest else ' [on another version]'}"
        for note in sorted(found, key=lambda note: note.frame)
    ]


def _comment_that_starts(start, task, client):
    for comment in gazu.task.all_comments_for_task(task, client=client):
        if (comment.get("text") or "").startswith(start):
            return comment
    return None


def _add_missing_previews(files, task, comment, version, client):
    """Upload the previews that a comment lacks; return whether there were any."""
    preview_ids = {
        each if isinstance(each, str) else each["id"] for each in comment.get("previews") or ()
    }
    there = [
        each
        for each in (gazu.task.all_previews_for_task(task, client=client) if preview_ids else ())
        if each["id"] in preview_ids
    ]
    # Kitsu stores the name of an uploaded file; a preview without a name has no file yet.
    uploaded = {each.get("original_name") for each in there}
    waiting = [each for each in there if not each.get("original_name")]
    main = there[0] if there else None
    missing = [file for file in files if file.stem not in uploaded]
    for file in missing:
        path = str(file)
        if waiting:
            made = gazu.task.upload_preview_file(waiting.pop(0), path, client=client)
        elif main is None:
            made = gazu.task.add_preview(
                task, comment, preview_file_path=path, revision=version, client=client
            )
        else:
            made = gazu.task.add_extra_preview(
                task, comment, main, preview_file_path=path, client=client
            )
        main = main or made
        if file == files[0]:
            gazu.task.set_main_preview(made, client=client)
    return bool(missing)


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
    """Run from the command line; return the exit code: 0 done, 1 the server fails, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("version", type=Path, help="folder of a published version")
    for name in ("project", "sequence", "shot", "task", "status"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--comment", default="")
    parser.add_argument("--notes", type=Path, help="notes saved in a report, for the comment")
    given = parser.parse_args(arguments)
    try:
        posted = publish_to_kitsu(
            given.version,
            Task(given.project, given.sequence, given.shot, given.task),
            status=given.status,
            client=connect(),
            comment=given.comment,
            notes=given.notes,
        )
    except UsdfaceError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    except Exception as error:  # of the network or the server
        sys.stderr.write(
            f"{given.version}: Kitsu fails: {type(error).__name__}: {error}; post it again, which "
            "adds what is missing\n"
        )
        return 1
    sys.stdout.write("posted\n" if posted else "is there already\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
