"""Store the video frame of each pair as an image next to the references."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from usdface.core.assets import References, Take, Video
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.side_files import check_side_folder, make_side_folder
from usdface.core.sidecars import images_folder
from usdface.core.text import first_few
from usdface.media.film.video import open_video
from usdface.media.picture.image import read_image_metadata, write_image
from usdface.specs.references import SelectSpec
from usdface.usdio.authoring import unique_names


@dataclass(frozen=True)
class PairImages:
    """Images of pairs."""

    files: tuple[Path | None, ...]
    """Per pair; None if it has no image."""
    notes: tuple[str, ...]
    """Reasons for missing images, per take."""


def store_images(
    spec: SelectSpec,
    references: References,
    sources: tuple[Take, ...],
    provenance: Provenance,
    progress: Progress,
) -> PairImages:
    """Write an image for every pair whose take has a video that shows it, unless --no-images.

    Images, named by take and frame, stay available if the video is moved or archived.
    """
    if not spec.images:
        return PairImages((), ())
    progress(0.0, "storing the video frames of the pairs")
    files: list[Path | None] = [None] * len(references.frames)
    notes = []
    folder = images_folder(spec.out)
    check_side_folder(folder)
    names = unique_names(re.sub(r"[^\w.-]", "_", take.name) for take in sources)
    for take, name in zip(sources, names, strict=True):
        pairs = [pair for pair, of in enumerate(references.takes) if of == take.name]
        named = {pair: folder / f"{name}.{int(references.frames[pair])}.jpg" for pair in pairs}
        if not named:
            continue
        if take.video is None:
            shown = _existing(named)
        else:
            try:
                shown = _write_take(named, references, take, take.video, provenance)
                foreign = [
                    file.name for pair, file in named.items() if pair not in shown and file.exists()
                ]
                if foreign:
                    notes.append(
                        f"{first_few(foreign)} in {folder.name}: not written by select, so the "
                        "pair has no picture; move the file away"
                    )
                if unseen := len(named) - len(shown) - len(foreign):
                    notes.append(
                        f"the video of {take.name} does not show {unseen} of {len(named)} pairs"
                    )
            except (InputError, OSError) as error:
                shown = _existing(named)
                kept = f"{len(shown)} of {len(named)} pairs of {take.name} keep their earlier"
                notes.append(
                    f"{kept} pictures, as the video cannot be read: {error}"
                    if shown
                    else f"the pairs of {take.name} have no pictures: {error}"
                )
        for pair, file in shown.items():
            files[pair] = file
    return PairImages(tuple(files), tuple(notes))


def _existing(files: Mapping[int, Path]) -> dict[int, Path]:
    """Return the existing images, of earlier selections."""
    return {pair: file for pair, file in files.items() if file.is_file()}


def _write_take(
    files: Mapping[int, Path],
    references: References,
    take: Take,
    video: Video,
    provenance: Provenance,
) -> dict[int, Path]:
    """Write the images of one take's pairs, in the order of the video; return those written."""
    shown = {}
    with open_video(video.file, video.rate) as movie:
        for pair in sorted(files, key=lambda each: int(references.frames[each])):
            frame = int(references.frames[pair])
            picture = movie.frame_at(take.video_seconds(frame))
            if picture is None:
                continue
            file = files[pair]
            make_side_folder(file.parent)
            if _is_ours(file) or not os.path.lexists(file):
                write_image(file, picture, metadata=provenance.metadata)
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
