"""Store the video frame of each pair as an image next to the references."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from usdface.core.assets import References, Take, Video
from usdface.core.errors import InputError
from usdface.core.side_files import check_side_folder, make_side_folder
from usdface.core.sidecars import images_folder
from usdface.core.text import first_few
from usdface.media.film.video import open_video
from usdface.media.picture.image import read_image_metadata, write_image
from usdface.specs.references import SelectSpec


@dataclass(frozen=True)
class PairImages:
    """Images of pairs."""

    files: tuple[Path | None, ...]
    """Per pair; None if it has no image."""
    notes: tuple[str, ...]
    """Reasons for missing images, per take."""


def write_pair_images(
    path: Path,
    references: References,
    sources: tuple[Take, ...],
    *,
    metadata: Mapping[str, object],
) -> PairImages:
    """Write an image for every pair whose take has a video that shows it.

    Images, named by take and frame, stay available if the video is moved or archived.
    """
    files: list[Path | None] = [None] * len(references.frames)
    notes = []
    folder = images_folder(path)
    check_side_folder(folder)
    for take in sources:
        pairs = [i for i, name in enumerate(references.takes) if name == take.name]
        if not pairs:
            continue
        shown: dict[int, Path] = {}
        if take.video is None:
            shown = _existing_pictures(folder, references, take, pairs)
        else:
            try:
                shown = _write_take(folder, references, take, take.video, pairs, metadata)
                foreign = [
                    pair
                    for pair in pairs
                    if pair not in shown and _path(folder, references, take, pair).exists()
                ]
                if foreign:
                    names = [_path(folder, references, take, pair).name for pair in foreign]
                    notes.append(
                        f"{first_few(names)} in {folder.name}: not written by select, so the pair "
                        "has no picture; move the file away"
                    )
                if unseen := len(pairs) - len(shown) - len(foreign):
                    notes.append(
                        f"the video of {take.name} does not show {unseen} of {len(pairs)} pairs"
                    )
            except (InputError, OSError) as error:
                shown = _existing_pictures(folder, references, take, pairs)
                kept = f"{len(shown)} of {len(pairs)} pairs of {take.name} keep their earlier"
                notes.append(
                    f"{kept} pictures, as the video cannot be read: {error}"
                    if shown
                    else f"the pairs of {take.name} have no pictures: {error}"
                )
        for pair, file in shown.items():
            files[pair] = file
    return PairImages(tuple(files), tuple(notes))


def _existing_pictures(
    folder: Path, references: References, take: Take, pairs: list[int]
) -> dict[int, Path]:
    """Return the existing images of earlier selections."""
    files = {pair: _path(folder, references, take, pair) for pair in pairs}
    return {pair: file for pair, file in files.items() if file.is_file()}


def _path(folder: Path, references: References, take: Take, pair: int) -> Path:
    """Return the path of a pair's image."""
    name = re.sub(r"[^\w.-]", "_", take.name)
    return folder / f"{name}.{int(references.frames[pair])}.jpg"


def _write_take(
    folder: Path,
    references: References,
    take: Take,
    video: Video,
    pairs: list[int],
    metadata: Mapping[str, object],
) -> dict[int, Path]:
    """Write the images of one take's pairs, in the order of the video; return those written."""
    shown = {}
    with open_video(video.file, video.rate) as movie:
        for pair in sorted(pairs, key=lambda each: int(references.frames[each])):
            frame = int(references.frames[pair])
            picture = movie.frame_at(take.video_seconds(frame))
            if picture is None:
                continue
            make_side_folder(folder)
            file = _path(folder, references, take, pair)
            if _is_ours(file) or not os.path.lexists(file):
                write_image(file, picture, metadata=metadata)
                shown[pair] = file
    return shown


def remove_unused_images(path: Path, files: tuple[Path | None, ...]) -> None:
    """Remove images of former pairs that `select` wrote."""
    used = {file.name for file in files if file is not None}
    folder = images_folder(path)
    check_side_folder(folder)
    for file in folder.glob("*.jpg") if folder.is_dir() else ():
        if file.name not in used and _is_ours(file):
            file.unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _is_ours(file: Path) -> bool:
    """Whether a file is a pair's image by its name and provenance."""
    if not re.fullmatch(r"[\w.-]+\.-?\d+\.jpg", file.name):
        return False
    try:
        return bool(
            read_image_metadata(file).get("step") == SelectSpec.model_fields["step"].default
        )
    except (InputError, OSError):
        return False
