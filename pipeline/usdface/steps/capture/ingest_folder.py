"""Ingest every take in a folder; files with the same stem form one take."""

from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

from usdface.capture.sniff import VIDEO_SUFFIXES, read_capture, recognise_format, visible_files
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.sidecars import is_usd_name
from usdface.core.text import first_few, pluralize, shell_word
from usdface.runner.execute import execute_each
from usdface.runner.result import StepResult
from usdface.specs.capture import IngestSpec

CAPTURE_SUFFIXES = (".c3d", ".trc")
"""Always treated as captures, so that a damaged file is reported."""
AUDIO_SUFFIXES = (".wav", ".flac", ".aif", ".aiff", ".mp3", ".m4a")

_FIELDS_OF_ONE_TAKE = ("take", "video", "audio", "timecode")
"""Options that differ between the takes of a folder."""

_TAKES = (".take.usda", ".samples.usdc")
"""Endings of ingest's outputs."""


@dataclass(frozen=True)
class Bundle:
    """The files of one take in a folder."""

    name: str
    """Common stem of the files."""
    captures: tuple[Path, ...]
    video: Path | None
    audio: Path | None


def find_bundles(folder: Path, only: str | None = None) -> list[Bundle]:
    """Group a folder's files by stem, without stems that have no capture matching `only`."""
    pattern = only if only is None or set("*?[") & set(only) else f"*{only}"
    captures: dict[str, list[Path]] = {}
    videos: dict[str, Path] = {}
    sounds: dict[str, Path] = {}
    for path in visible_files(folder):
        suffix = path.suffix.lower()
        if suffix in VIDEO_SUFFIXES:
            videos.setdefault(path.stem, path)
        elif suffix in AUDIO_SUFFIXES:
            sounds.setdefault(path.stem, path)
        elif pattern is None or fnmatch(path.name.lower(), pattern.lower()):
            if _is_capture(path):
                captures.setdefault(path.stem, []).append(path)
    return [
        Bundle(stem, tuple(paths), videos.get(stem), sounds.get(stem))
        for stem, paths in captures.items()
    ]


def ingest_folder(
    folder: Path,
    out: Path,
    shared: IngestSpec,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StepResult:
    """Ingest every take in a folder to `out`, with the options of `shared` but not its files."""
    for name in _FIELDS_OF_ONE_TAKE:
        if getattr(shared, name):
            raise InputError(
                f"{folder}: --{name} is for a single take; in a folder, names and timecode come "
                "from the captures, video and audio from files of the same name; leave it out"
            )
    bundles = _bundles(folder, shared.only)
    specs = [
        shared.model_copy(
            update={
                "sources": bundle.captures,
                "out": out / f"{bundle.name}.take.usda",
                "video": bundle.video,
                "audio": bundle.audio,
                "take": bundle.name,
                "only": None,
            }
        )
        for bundle in bundles
    ]
    result = execute_each(
        specs,
        folder=folder,
        out=out,
        done_as="ingested",
        overwrite=overwrite,
        progress=progress,
    )
    return replace(result, notes=(*result.notes, *_left_out(folder, bundles)))


def _bundles(folder: Path, only: str | None) -> list[Bundle]:
    bundles = find_bundles(folder, only)
    if bundles:
        return bundles
    if only is not None:
        raise InputError(
            f"{folder}: no name of a capture matches --only {only}; leave it out, or give the "
            "ending of the names, such as c3d"
        )
    files = visible_files(folder)
    movies = [each.name for each in files if each.suffix.lower() in VIDEO_SUFFIXES]
    if movies:
        raise InputError(
            f"{folder}: holds {pluralize(len(movies), 'movie')} and no capture: track the face in "
            f"each, as with `usdface track {shell_word(folder / movies[0])} --out "
            f"{shell_word(Path(movies[0]).stem + '.take.usda')}` ({first_few(movies)})"
        )
    raise InputError(
        f"{folder}: holds no file of a known capture format; name the folder that holds the "
        "captures, or a file with --format"
    )


def _left_out(folder: Path, bundles: list[Bundle]) -> tuple[str, ...]:
    """Return a note on the files of a folder that are in no take."""
    used = {path for each in bundles for path in (*each.captures, each.video, each.audio) if path}
    others = [
        path.name
        for path in visible_files(folder)
        if path not in used and not path.name.endswith(_TAKES)
    ]
    if not others:
        return ()
    return (
        f"not used, as their content is no known capture or --only excludes them: "
        f"{first_few(others)}",
    )


def _is_capture(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix in CAPTURE_SUFFIXES:
        return True
    if is_usd_name(path):
        return not path.name.endswith(_TAKES)
    try:
        if recognise_format(path).name.startswith("weights-"):
            read_capture(path)  # other tables, such as keys, are refused
    except (InputError, OSError):
        return False
    return True
