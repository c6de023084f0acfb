"""Display transforms of rendered light: views of an OpenColorIO configuration."""

import os
from collections.abc import Callable

import numpy as np
import OpenImageIO
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.picture.color import bytes_from_linear
from usdface.media.picture.image import reason_of

BUILT_IN = "ocio://default"
_RENDERED = "lin_rec709"
"""Alias of the renderer's colour space in configurations."""

DisplayView = Callable[[ArrayLike], ByteImage]


def display_view(name: str | None) -> DisplayView:
    """Return the function from rendered light, (height, width, 3) linear Rec.709, to bytes.

    Parameters
    ----------
    name : str or None
        A view of the configuration's default display, or ``DISPLAY/VIEW``; None is sRGB. The
        configuration is that of ``$OCIO``, or else the one built into OpenColorIO.
    """
    if name is None:
        return lambda light: bytes_from_linear(np.asarray(light, np.float32))
    where = os.environ.get("OCIO") or BUILT_IN
    config = OpenImageIO.ColorConfig(where)
    problem = reason_of(config)
    if problem or not config.getDisplayNames():
        raise InputError(f"{where}: no usable OpenColorIO configuration: {problem or 'no display'}")
    display, _, view = name.rpartition("/")
    display = display or config.getDefaultDisplayName()
    if display not in config.getDisplayNames():
        raise InputError(
            f"{where}: has no display {display!r}; it has {', '.join(config.getDisplayNames())}"
        )
    views = config.getViewNames(display)
    if view not in views:
        listed = ", ".join(map(repr, views))
        raise InputError(f"{where}: display {display!r} has no view {view!r}; it has {listed}")

    def show(light: ArrayLike) -> ByteImage:
        source = OpenImageIO.ImageBuf(np.ascontiguousarray(light, np.float32))
        shown = OpenImageIO.ImageBufAlgo.ociodisplay(
            source, display, view, _RENDERED, "", True, False, "", "", where
        )
        if shown.has_error:
            raise InputError(f"{where}: cannot show linear Rec.709 by {view!r}: {reason_of(shown)}")
        pixels = np.asarray(shown.get_pixels(OpenImageIO.FLOAT), np.float32)
        return np.asarray(np.clip(pixels * 255 + 0.5, 0, 255), np.uint8)

    return show
