"""What a farm maps or draws in parts and joins is as done as what one process makes whole."""

from itertools import pairwise
from pathlib import Path

from pydantic import ValidationError

from usdface.core.provenance import Provenance
from usdface.runner.origin import provenance_of, spec_of
from usdface.specs.base import Spec
from usdface.specs.paths import frame_range
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec
from usdface.usdio.referenced_files import frame_range_of


def chunk_specs(spec: Spec, made: Provenance, path: Path) -> tuple[Spec, ...]:
    """Return the specs by which a file that joins parts was made, if they come to a given one.

    Parameters
    ----------
    spec : Spec
        What would make the file whole.
    made : Provenance
        What the file says of its making.
    path : Path
        The file.

    Returns
    -------
    tuple of Spec
        The join, and each part's as it should be: whether all are done is for the caller to find.
        Empty if the file was made otherwise, or of other frames.
    """
    join = _join_of(spec, made)
    if join is None:
        return ()
    folder = path.resolve().parent
    join = join.with_paths(lambda part: folder / part)
    parts, stretches = list[Spec](), list[tuple[int, int]]()
    for part in join.parts:
        frames = spec_of(provenance_of(part)).get("frames")
        changed = {"frames": frames, "out": part}
        changed |= {"chunk": None} if isinstance(spec, MapSpec) else {"sound": False}
        try:
            stretch = frame_range(frames)
        except (AttributeError, ValueError):
            return ()
        if stretch is None:
            return ()
        stretches.append(stretch)
        parts.append(spec.model_copy(update=changed))
    stretches.sort()
    follow = all(one[1] + 1 == other[0] for one, other in pairwise(stretches))
    if not follow or (stretches[0][0], stretches[-1][1]) != _frames_wanted(spec):
        return ()
    return (join, *parts)


def _join_of(spec: Spec, made: Provenance) -> JoinSpec | MovieJoinSpec | None:
    kind: type[JoinSpec] | type[MovieJoinSpec]
    if isinstance(spec, MapSpec):
        kind = JoinSpec
    elif isinstance(spec, MovieSpec):
        kind = MovieJoinSpec
    else:
        return None
    if made.step != kind.step_name():
        return None
    try:
        return kind.model_validate(spec_of(made))
    except ValidationError:
        return None


def _frames_wanted(spec: Spec) -> tuple[int, int] | None:
    if isinstance(spec, MapSpec):
        return frame_range(spec.frames) or frame_range_of(spec.take)
    if isinstance(spec, MovieSpec):
        return frame_range(spec.frames) or frame_range_of(spec.performance)
    return None
