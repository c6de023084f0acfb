"""Array types by element, as every signature names them; shapes are in the docstrings."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
RealArray = NDArray[np.floating]
"""Single or double precision: the result has the precision of the argument."""
ComplexArray = NDArray[np.complex64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ByteImage = NDArray[np.uint8]
"""(height, width, 3), sRGB."""
