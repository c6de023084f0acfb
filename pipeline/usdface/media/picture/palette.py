"""Colours that every chart and sheet has in common."""

from usdface.media.picture.canvas import Color

PAGE: Color = (22, 23, 26)
"""What pictures lie on."""

FIRST: Color = (120, 200, 255)
SECOND: Color = (255, 178, 92)
"""Blue and orange, which most kinds of colour blindness keep apart: of two curves, the one that is
given or was before, and the one that is solved, proposed or came after."""
