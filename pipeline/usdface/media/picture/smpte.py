"""The packed number in which EXR and DPX carry a timecode (SMPTE 12M)."""

from usdface.core.errors import InputError
from usdface.core.timecode import LABEL

_DROP_BIT = 1 << 6


def pack_timecode(label: str) -> int:
    """Return a label as binary-coded decimal, hours in the highest byte.

    Parameters
    ----------
    label : str
        ``HH:MM:SS:FF``, or ``;`` before FF for drop-frame.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If the label is malformed.
    """
    match = LABEL.match(label)
    if match is None or match[1] > "23" or match[2] > "59" or match[3] > "59" or match[5] > "39":
        raise InputError(f"timecode {label!r} is not hh:mm:ss:ff; correct it")
    packed = 0
    for group in (1, 2, 3, 5):
        packed = packed << 8 | int(match[group], 16)  # decimal digits, read as hexadecimal
    return packed | (_DROP_BIT if match[4] == ";" else 0)


def unpack_timecode(packed: int) -> str:
    """Return the label of a packed timecode; flags other than drop-frame are ignored."""
    hours, minutes, seconds, frames = (
        packed >> shift & mask for shift, mask in ((24, 0x3F), (16, 0x7F), (8, 0x7F), (0, 0x3F))
    )
    mark = ";" if packed & _DROP_BIT else ":"
    return f"{hours:02x}:{minutes:02x}:{seconds:02x}{mark}{frames:02x}"
