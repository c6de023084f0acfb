"""How the machine that wrote a C3D file stored its numbers: Intel, DEC or MIPS."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Processor:
    """Byte order of a C3D file.

    Attributes
    ----------
    name : {'Intel', 'DEC', 'MIPS'}
    order : {'<', '>'}
        Of integers, and of floats but for DEC.
    """

    name: str
    order: str

    @property
    def integer(self) -> np.dtype[np.int16]:
        """16-bit signed."""
        return np.dtype(f"{self.order}i2")

    @property
    def unsigned(self) -> np.dtype[np.uint16]:
        """16-bit unsigned."""
        return np.dtype(f"{self.order}u2")

    def floats(self, raw: bytes | bytearray | memoryview) -> NDArray[np.float32]:
        """Decode 32-bit floats.

        DEC machines stored VAX F floats: the two 16-bit words the other way round and an exponent
        that is larger by two, so the swapped words read as IEEE are four times the value.
        """
        if self.name != "DEC":
            return np.frombuffer(raw, f"{self.order}f4").astype(np.float32, copy=False)
        words = np.frombuffer(raw, "<u2")[: len(raw) // 4 * 2].reshape(-1, 2)
        swapped = np.ascontiguousarray(words[:, ::-1]).view("<f4")[:, 0]
        with np.errstate(invalid="ignore"):  # a VAX reserved operand reads as a signalling NaN
            return (swapped * np.float32(0.25)).astype(np.float32, copy=False)


PROCESSORS = {
    84: Processor("Intel", "<"),
    85: Processor("DEC", "<"),
    86: Processor("MIPS", ">"),
}
"""By the fourth byte of the parameter section."""
