"""How many frames a file claims, held against how many it was sampled at.

A reader counts frame by frame. One damaged time code would have it count for hours, and ask for
memory that nobody has: a span that the samples do not bear out is refused first.
"""

from collections.abc import Sequence

from usdface.core.errors import InputError

_MOST_FRAMES = 10_000_000
"""23 hours at 120 frames per second: more is a mistake, and would ask for memory nobody has."""
FARTHEST_FRAME = 1e12
"""Clocks of stages that count frames from their own midnight stay far below it."""
FRAMES_BETWEEN_KEYS = 100
"""Of animation that a person keyed, on average; captures and solves have a sample a frame."""
UNSAMPLED_FRAMES = 100_000
"""So many are counted without asking: it takes a second or two."""


def check_frame_span(where: str, first: float, last: float, *, samples: int | None) -> None:
    """Refuse a range of frames that is none, or that a file's own samples do not bear out.

    Parameters
    ----------
    where : str
        File and prim, for the message.
    first, last : float
        Inclusive; what a file says, finite or not.
    samples : int or None
        Time codes at which the file has a value; None where nothing in it is read by frames.

    Raises
    ------
    InputError
        If an end is no frame, or there are too many frames between them.
    """
    if not (abs(first) < FARTHEST_FRAME and abs(last) < FARTHEST_FRAME):  # also catches NaN
        raise InputError(
            f"{where}: {first:g} to {last:g} is no range of frames; correct its ends, or write the "
            "file again"
        )
    count = last - first + 1
    borne_out = _MOST_FRAMES if samples is None else FRAMES_BETWEEN_KEYS * samples
    if count > min(_MOST_FRAMES, max(UNSAMPLED_FRAMES, borne_out)):
        held = "nothing" if samples is None else f"{samples} samples"
        raise InputError(
            f"{where}: {held} on {count:.0f} frames, {first:g} to {last:g}: an end is damaged, or "
            "a sample lies far off; correct it, or write the file again"
        )


def span_of_samples(where: str, times: Sequence[float]) -> tuple[int, int]:
    """Return the first and the last frame of ascending time codes.

    Raises
    ------
    InputError
        If they span more frames than a file of so few samples can mean.
    """
    check_frame_span(where, times[0], times[-1], samples=len(times))
    return round(times[0]), round(times[-1])
