"""What `usdface submit` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, Positional, Spec


class SubmitSpec(Spec):
    """Hand a job to a farm: one task per step and take, mapping cut into chunks of frames.

    Writes an Open Job Description bundle, a folder, and runs it: here with `openjd run`, or on
    Deadline Cloud or OpenCue. Every task can be killed, retried or run twice: what is done is
    skipped, and the files are the same bytes. A worker needs usdface and nothing else.
    """

    example: ClassVar[str] = "usdface submit kitchen.job.yaml --farm deadline"

    step: Literal["submit"] = "submit"
    job: Annotated[FilePath, Positional()]
    """A job as YAML or JSON."""
    farm: Literal["openjd", "deadline", "opencue"] = "openjd"
    """Where the job runs; `openjd` runs it on this machine."""
    out: Path | None = None
    """The bundle's folder; beside the job by default, with the hash of what it holds in its
    name."""
    chunk: Annotated[int, Field(ge=100, le=10_000_000)] = 614_400
    """Frames that one task maps, where a take's frames are known: 85 minutes at 120 frames per
    second, of which the start of a process is a twentieth. A retry finds the same frames: they are
    fixed here."""
    clips: Literal["auto", "always", "never"] = "auto"
    """Whether chunks stay where they are and are played as value clips, or are merged into one
    layer; `auto` merges up to 1 GB."""
    movie_chunk: Annotated[int, Field(ge=24)] | None = None
    """Frames of the take that one task of a movie draws; the whole movie by default."""
    priority: Annotated[int, Field(ge=0, le=100)] | None = None
    """The farm's priority of the job; its own default if not given."""
    write_only: bool = False
    """Write the bundle and run nothing."""
