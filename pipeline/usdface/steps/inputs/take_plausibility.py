"""Where a take meets a rig: what ingest noted of the take, or its judgement now; and the rig's."""

from pathlib import Path

import numpy as np

from usdface.core.assets import Markers, Rig
from usdface.model.placement.plausibility import (
    judge_markers,
    settle_findings,
)
from usdface.model.placement.rig_orientation import check_rig_stands
from usdface.steps.inputs.cleaned_takes import CleanedTakes
from usdface.usdio.take.read import TakeReader

_SAMPLE_FRAMES = 64


def plausibility_notes(takes: CleanedTakes, paths: tuple[Path, ...], rig: Rig) -> list[str]:
    """Return what is odd about takes and the rig.

    Raises
    ------
    InputError
        If a take that was not judged at ingest cannot be a human face's, or the rig's head lies.
    """
    notes = [f"{rig.file.name}: {doubt}" for doubt in check_rig_stands(rig)]
    for index, (path, source) in enumerate(zip(paths, takes.sources, strict=True)):
        doubts = source.doubts
        if doubts is None:
            usable = takes.usable[index]
            markers = Markers(
                takes.marker_names, takes.positions[index], usable, usable.astype(np.float32)
            )
            doubts = _judge(markers, path, float(source.rate))
        notes += [f"{source.name}: {doubt}" for doubt in doubts]
    return notes


def bound_take_notes(take: TakeReader) -> list[str]:
    """Return what is odd about a take, by frames spread over it where ingest has not judged it.

    Raises
    ------
    InputError
        As `plausibility_notes`.
    """
    if take.doubts is not None:
        return list(take.doubts)
    frames = np.unique(np.linspace(take.first_frame, take.last_frame, _SAMPLE_FRAMES).astype(int))
    markers = take.read_markers_at(frames.tolist())
    return [] if markers is None else list(_judge(markers, take.path, None))


def _judge(markers: Markers, path: Path, rate: float | None) -> tuple[str, ...]:
    return settle_findings(
        judge_markers(markers, rate), where=path, before_remedy="ingest it again and "
    )
