"""Extraction of the published files: weights with edits, a layer to open, sheet and movie."""

import contextlib
import logging
import re
import shutil
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from usdface.core.progress import Progress, part, silent
from usdface.core.sidecars import controls_path, head_path, weights_path
from usdface.publish.collect import PublishItem
from usdface.runner.execute import create_folder, execute
from usdface.runner.origin import make_provenance
from usdface.specs.edits import BakeSpec
from usdface.specs.review import MovieSpec, SheetSpec
from usdface.steps.edits.bake import driving_notes
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.write import writing_top
from usdface.usdio.rig.reference import read_rig_of_stage, replaced_motion_notes

log = logging.getLogger(__name__)

UNFINISHED_FOLDER = re.compile(r"\.[0-9a-f]{12}")
ABANDONED_SECONDS = 7 * 86400.0
"""Age from which an unfinished extraction is removed."""


@dataclass(frozen=True)
class ReviewOptions:
    """Pictures for the review of a performance, made if its take exists."""

    sheet: bool = True
    movie: bool = False
    rows: int = 12
    """Frames on the sheet."""
    quality: Literal["draft", "final"] = "final"


@dataclass(frozen=True)
class Extracted:
    """Files of a version before its integration."""

    item: PublishItem
    folder: Path
    """Next to the future version, so that relative references stay valid."""
    files: Mapping[str, str]
    """File names by role: `performance`, `weights`, `head`, `controls`, `sheet`, `movie`."""
    movie_pictures: int = 0
    movie_rate: float = 0.0
    """`movie_pictures`, `movie_rate`: number of pictures and pictures per second of the movie, if
    any."""

    def path(self, role: str) -> Path | None:
        """Return the file of a role, or None."""
        return self.folder / self.files[role] if role in self.files else None

    def discard(self) -> None:
        """Remove the files."""
        shutil.rmtree(self.folder, ignore_errors=True)


def extract_performance(
    item: PublishItem,
    root: Path,
    *,
    review: ReviewOptions | None = None,
    progress: Progress = silent,
) -> Extracted:
    """Make the files of a version in a temporary folder.

    Parameters
    ----------
    root : Path
        Folder of publishes, with a folder for each item.

    Returns
    -------
    Extracted
        For `integrate_performance`, or to be discarded.

    Raises
    ------
    InputError
        If a file cannot be read or made; the temporary folder is then removed.
    """
    review = review or ReviewOptions()
    folder = root / item.name / f".{uuid.uuid4().hex[:12]}"
    _clear_abandoned(folder.parent)
    create_folder(folder, remedy="choose another root folder")
    try:
        return _extract(item, folder, review, progress)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _clear_abandoned(folder: Path) -> None:
    """Remove folders of killed publishes that are older than `ABANDONED_SECONDS`."""
    if not folder.is_dir():
        return
    with contextlib.suppress(OSError):  # removed meanwhile, or without permission
        for each in folder.iterdir():
            old = time.time() - each.stat().st_mtime > ABANDONED_SECONDS
            if old and UNFINISHED_FOLDER.fullmatch(each.name) and each.is_dir():
                shutil.rmtree(each, ignore_errors=True)


def _extract(
    item: PublishItem, folder: Path, review: ReviewOptions, progress: Progress
) -> Extracted:
    opened = folder / f"{item.name}.usda"
    bake = BakeSpec(performance=item.performance, out=weights_path(opened))
    reader = PerformanceReader(item.performance)
    rig = read_rig_of_stage(reader.stage, reader.animation)
    header, made_by = reader.header, make_provenance(bake)
    with writing_top(opened, header, rig, copied=reader, provenance=made_by):
        baked = execute(bake, progress=part(progress, 0.0, 0.3))
    published = PerformanceReader(opened)
    replaced = replaced_motion_notes(published.stage, published.animation)
    published_too = driving_notes(reader)  # a version has these layers as well
    for note in (*(each for each in baked.notes if each not in published_too), *replaced):
        log.warning("%s: %s", opened.name, note)
    files = {"performance": opened.name, "weights": bake.out.name}
    driving = {"head": head_path(opened), "controls": controls_path(opened)}
    files |= {role: each.name for role, each in driving.items() if each.is_file()}
    if item.take is not None and reader.time_shift:
        log.warning("%s: no pictures: a layer moves it %s", item.performance, reader.time_shift)
    if item.take is None or reader.time_shift:
        return Extracted(item, folder, files)
    if review.sheet:
        sheet = folder / f"{item.name}.sheet.jpg"
        spec = SheetSpec(
            performance=opened, take=item.take, out=sheet, rows=review.rows, quality=review.quality
        )
        execute(spec, progress=part(progress, 0.3, 0.6 if review.movie else 1.0))
        files["sheet"] = sheet.name
    if review.movie:
        movie = folder / f"{item.name}.review.mp4"
        made = execute(
            MovieSpec(performance=opened, take=item.take, out=movie, quality=review.quality),
            progress=part(progress, 0.6, 1.0),
        ).figures
        files["movie"] = movie.name
        pictures, rate = int(str(made["pictures"])), float(str(made["rate"]))
        return Extracted(item, folder, files, pictures, rate)
    return Extracted(item, folder, files)
