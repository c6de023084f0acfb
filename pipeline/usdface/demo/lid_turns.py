"""How far each shape turns the lids: what the shapes sculpt and the actor's blinks reckon with."""

from collections.abc import Mapping
from types import MappingProxyType

BLINK_MEETS = 0.16
"""Where the lids of a blink meet, as a part of the eye's opening from the lower lid's edge."""

LID_TURNS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "eyeBlink": (1.0, 1.0),
        "eyeSquint": (0.22, 2.0),
        "eyeWide": (-0.34, -1.3),
        "eyeLookUp": (-0.24, 0.3),
        "eyeLookDown": (0.50, -1.6),
        "cheekSquint": (0.0, 1.7),
        "mouthSmile": (0.0, 0.9),
        "noseSneer": (0.06, 0.8),
        "browDown": (0.18, 0.0),
    }
)
"""Turn of the upper and of the lower lid, in what a blink turns them; negative opens."""


def closing(name: str) -> float:
    """Return how much of the eye's opening a shape without its side closes at weight 1."""
    upper, lower = LID_TURNS[name]
    return (1.0 - BLINK_MEETS) * upper + BLINK_MEETS * lower
