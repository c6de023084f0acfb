"""A five-by-seven pixel font, so that a sheet is still made where no real font can be drawn."""

import unicodedata

import numpy as np

from usdface.core.arrays import Float32Array

# One byte a column, the lowest bit on top; capitals serve for small letters.
_GLYPHS = {
    " ": "0000000000", "A": "7E0909097E", "B": "7F49494936", "C": "3E41414122",
    "D": "7F4141413E", "E": "7F49494941", "F": "7F09090901", "G": "3E41494A3A",
    "H": "7F0808087F", "I": "00417F4100", "J": "2040413F01", "K": "7F08142241",
    "L": "7F40404040", "M": "7F020C027F", "N": "7F0408107F", "O": "3E4141413E",
    "P": "7F09090906", "Q": "3E4151215E", "R": "7F09192946", "S": "2649494932",
    "T": "01017F0101", "U": "3F4040403F", "V": "1F2040201F", "W": "3F4038403F",
    "X": "6314081463", "Y": "0708700807", "Z": "6151494543", "0": "3E5149453E",
    "1": "00427F4000", "2": "6251494946", "3": "2241494936", "4": "1814127F10",
    "5": "2745454539", "6": "3C4A494930", "7": "0171090503", "8": "3649494936",
    "9": "064949291E", ".": "0060600000", ",": "0050300000", ":": "0036360000",
    ";": "0056360000", "-": "0808080808", "+": "08083E0808", "/": "2010080402",
    "%": "2313086462", "(": "001C224100", ")": "0041221C00", "=": "1414141414",
    "_": "4040404040", "'": "0000070000", "#": "147F147F14", "<": "0814224100",
    ">": "0041221408", "?": "0201510906",
}  # fmt: skip
_PLAIN = {"ß": "SS", "–": "-", "—": "-", "·": "-", "…": "..", "×": "X", "→": ">", "ø": "O"}


def pixel_mask(text: str, *, size: int) -> Float32Array:
    """Draw one line in the built-in font.

    Parameters
    ----------
    text : str
        Accents are left off; what has no glyph shows as a question mark.
    size : int
        Height of the letters' body [pixels]; rounded to whole pixels of the font.

    Returns
    -------
    (height, width) float32 array
        0 or 1; as high as a line of the real font of that size.
    """
    scale = max(round(size / 10), 1)
    replaced = "".join(_PLAIN.get(letter, letter) for letter in text)
    letters = [c for c in unicodedata.normalize("NFKD", replaced) if not unicodedata.combining(c)]
    columns = b"".join(bytes.fromhex(_GLYPHS.get(c.upper(), _GLYPHS["?"])) + b"\0" for c in letters)
    bits = (np.frombuffer(columns, np.uint8)[None, :] >> np.arange(7)[:, None]) & 1
    drawn = np.kron(bits, np.ones((scale, scale))).astype(np.float32)
    mask = np.zeros((round(size * 1.35), drawn.shape[1]), np.float32)
    top = max(round(size * 1.02) - len(drawn), 0)
    rows = min(len(drawn), len(mask) - top)
    mask[top : top + rows] = drawn[:rows]
    return mask
