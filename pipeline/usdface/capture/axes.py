"""Conversion of a capture's units and axes to millimetres with Y up."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError

_MM_PER_UNIT = {
    name: mm
    for mm, names in (
        (1.0, ("mm", "millimeter", "millimetre")),
        (10.0, ("cm", "centimeter", "centimetre")),
        (100.0, ("dm", "decimeter", "decimetre")),
        (1000.0, ("m", "meter", "metre")),
        (25.4, ("in", "inch", "inches")),
        (304.8, ("ft", "feet")),
    )
    for name in names
}
_CUT_LENGTH = 4
"""Some programs truncate the unit in a C3D file to four letters."""
_AXES = {"X": 0, "Y": 1, "Z": 2}
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from Z up to Y up."""
_UPRIGHT = {
    "y": np.eye(3),
    "z": Z_UP,
    "x": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "-x": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "-z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations that map an axis to +Y; the heading of the face is arbitrary."""


def mm_per_unit(units: str, *, where: str) -> float:
    """Return the millimetres per unit."""
    key = units.strip().lower()
    scale = _MM_PER_UNIT.get(key, _MM_PER_UNIT.get(key.removesuffix("s")))
    if scale is None and len(key) == _CUT_LENGTH:  # "mete", "mill", "cent" and so on
        cut = {mm for name, mm in _MM_PER_UNIT.items() if name.startswith(key)}
        scale = cut.pop() if len(cut) == 1 else None
    if scale is None:
        raise InputError(
            f"{where}: unit {units!r}; it must be one of mm, cm, dm, m, in or ft; "
            "set it with --units"
        )
    return scale


def rotation_to_y_up(*, up: str, where: str) -> FloatArray:
    """Return the rotation that maps `up`, such as 'y', 'z' or '-x', to +Y."""
    if up.lower() not in _UPRIGHT:
        raise InputError(f"{where}: up axis {up!r}; it must be one of {', '.join(_UPRIGHT)}")
    return _UPRIGHT[up.lower()]


def rotation_from_screen(x_screen: str, y_screen: str, *, where: str) -> FloatArray:
    """Return the rotation to Y up from the axes that point right and up: ``'+X'``, ``'-Z'``."""
    right, up = _signed_axis(x_screen), _signed_axis(y_screen)
    if right is None or up is None or not np.isclose(right @ up, 0):
        raise InputError(
            f"{where}: X_SCREEN {x_screen!r}, Y_SCREEN {y_screen!r}; they must be two different "
            "axes such as '+X' and '+Z'; set the up axis with --up"
        )
    return np.stack([right, up, np.cross(right, up)])


def _signed_axis(text: str) -> FloatArray | None:
    """Return the unit vector of ``'+X'``, ``'-y'`` or ``'Z'``."""
    text = text.strip().upper()
    axis = _AXES.get(text[-1:])
    if axis is None or text[:-1] not in ("", "+", "-"):
        return None
    vector = np.zeros(3)
    vector[axis] = -1.0 if text[0] == "-" else 1.0
    return vector
