"""Specs of commands that are not steps of a job: submit and tune."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from usdface.specs.base import MovedRigSpec, Positional, Spec
from usdface.specs.paths import FilePath, ReadPath, Reads


class TuneSpec(MovedRigSpec):
    """Tune the weights of reference pairs on a page in your browser.

    Prints a link that works on this machine only, and serves the page until interrupted (Ctrl+C).
    Every change is stored on disk immediately, and in the tuned layer after a short pause. One
    person can tune at a time.
    """

    example = "usdface tune hero.references.usda"

    section = "references"

    step: Literal["tune"] = "tune"
    references: Annotated[FilePath, Reads(alone=True), Positional()]
    """The references asset written by `usdface select`."""
    takes: Annotated[tuple[Path, ...], Reads()] = ()
    """Takes whose video is shown, if they have moved since `usdface select`."""
    notes: ReadPath | None = None
    """Notes saved by a report, shown at the pairs of the same frames."""
    frame: int | None = None
    """Frame of the pair to begin with. Default: the first pair."""
    port: Annotated[int, Field(ge=0, le=65535)] = 0
    """Port of the page. Default: one derived from the asset's path."""
    author: str = ""
    """Your name, stored with the pairs and markers that you change. Default: your login name."""
    take_over: bool = False
    """Take over the lock from another person; their saved changes are kept."""
    browser: bool = True
    """Open the page in the browser."""


class SubmitSpec(Spec):
    """Submit a job to a render farm: one task per step and take, mapping split into chunks.

    Writes an Open Job Description bundle, a folder, and runs it: on this machine with `openjd run`,
    on Deadline Cloud or on OpenCue. Any task can be killed, retried or run twice: finished work is
    skipped, and results are identical byte for byte. A worker needs only usdface.
    """

    example = "usdface submit kitchen.job.yaml --farm deadline"

    section = "jobs"

    step: Literal["submit"] = "submit"
    job: Annotated[FilePath, Positional()]
    """Job file, YAML or JSON."""
    farm: Literal["openjd", "deadline", "opencue"] = "openjd"
    """Where the job runs. `openjd` runs it on this machine."""
    out: Path | None = None
    """Folder of the bundle. Default: next to the job, with a hash of its contents in the name."""
    chunk: Annotated[int, Field(ge=100, le=10_000_000)] = 614_400
    """Frames per mapping task, if the number of frames is known before the job runs. The default,
    85 minutes at 120 frames per second, keeps the share of process start at about 5 %. Chunks are
    fixed, so that a retry maps the same frames."""
    clips: Literal["auto", "always", "never"] = "auto"
    """`always` plays the chunks where they are, as value clips; `never` merges them into one layer;
    `auto` merges up to 1 GB."""
    movie_chunk: Annotated[int, Field(ge=24)] | None = None
    """Frames of the take per movie task. Default: the whole movie."""
    track_chunk: Annotated[int, Field(ge=24)] | None = None
    """Frames of a video per tracking task. Default: the whole video. Videos of several cameras are
    not split."""
    priority: Annotated[int, Field(ge=0, le=100)] | None = None
    """Priority of the job. Default: the farm's."""
    write_only: bool = False
    """Write the bundle without running it."""
