"""A take's markers as a mapping reads them, in pieces: one head space for the whole take."""

import numpy as np

from usdface.core.assets import Markers, TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import HeadSpace, find_head_space
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.usdio.take.read import TakeReader


def take_head_space(take: TakeReader, mapping: TrainedMapping) -> HeadSpace:
    """Find how a take's markers become a mapping's, from frames spread over all of it.

    Raises
    ------
    InputError
        If the take is not stabilised, or has too few of the mapping's markers.
    """
    count = take.last_frame - take.first_frame + 1
    picks = np.linspace(take.first_frame, take.last_frame, min(count, SAMPLE_FRAMES)).astype(int)
    if take.first_frame <= take.neutral_frame <= take.last_frame:
        picks = np.union1d(picks, take.neutral_frame)
    sample = _require_markers(take, take.read_markers_at(picks.tolist()))
    try:
        return find_head_space(
            face_of_mapping(mapping),
            sample,
            frames=picks,
            rate=float(take.rate),
            performer=take.performer,
            session=take.session,
        )
    except InputError as error:
        raise InputError(f"{take.path}: {error}") from error


def read_markers(take: TakeReader, first: int, last: int) -> Markers:
    """Read the markers of some frames.

    Raises
    ------
    InputError
        If the take has none.
    """
    return _require_markers(take, take.read(first, last, head_motion=False).markers)


def _require_markers(take: TakeReader, markers: Markers | None) -> Markers:
    if markers is None:
        raise InputError(f"{take.path}: has no markers; ingest a capture that has")
    return markers
