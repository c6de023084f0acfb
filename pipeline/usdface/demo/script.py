"""Script of the performance: sentences, moods, durations and visemes of sounds.

The moods are those of Deng et al. (2006): neutral, happiness, anger, sadness.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from usdface.speech.phones import SILENCE, PhoneTrack, Span

Weights = Mapping[str, float]


@dataclass(frozen=True)
class SpokenLine:
    """One sentence in one mood."""

    emotion: str
    start: float
    stop: float
    """`start`, `stop`: interval of the mood [s]."""
    speech: float
    """Start of the first sound [s]."""
    phones: tuple[tuple[str, int], ...]
    """ARPAbet phone and duration [ms], in order."""
    stresses: tuple[float, ...]
    """Times of accents by brows and head [s]."""


@dataclass(frozen=True)
class TimedPhone:
    """One sound of the script with its times [s]."""

    phone: str
    start: float
    stop: float
    emotion: str


def _phones(text: str) -> tuple[tuple[str, int], ...]:
    """Parse ``PHONE:milliseconds`` items."""
    items = (item.split(":") for item in text.split())
    return tuple((phone, int(duration)) for phone, duration in items)


DURATION_SECONDS = 15.0
"""Length of the performance [s]."""

NEUTRAL_TIME = 0.25
"""Time of the face at rest [s]."""

LINES = (
    SpokenLine(
        "neutral",
        0.0,
        3.8,
        0.75,
        # Good morning, this is a very plain face.
        _phones(
            "G:70 UH:85 D:60 M:80 AO:130 R:80 N:60 IH:75 NG:110 SIL:190 DH:60 IH:75 S:80 IH:70 "
            "Z:70 AH:65 V:75 EH:85 R:75 IY:100 P:95 L:60 EY:150 N:90 F:110 EY:180 S:140"
        ),
        (0.95, 2.3),
    ),
    SpokenLine(
        "happiness",
        3.8,
        7.6,
        4.55,
        # Oh wow, you made me a wonderful film!
        _phones(
            "OW:210 SIL:70 W:90 AW:260 SIL:170 Y:70 UW:110 M:85 EY:110 D:65 M:75 IY:95 AH:60 "
            "W:80 AH:85 N:70 D:50 ER:80 F:85 AH:60 L:75 F:105 IH:110 L:85 M:140"
        ),
        (4.65, 5.0, 6.1),
    ),
    SpokenLine(
        "anger",
        7.6,
        11.2,
        8.3,
        # No! Stop it. Move that back, now.
        _phones(
            "N:85 OW:230 SIL:230 S:95 T:60 AA:140 P:90 IH:70 T:80 SIL:260 M:85 UW:110 V:75 DH:55 "
            "AE:95 T:60 B:80 AE:150 K:90 SIL:120 N:75 AW:280"
        ),
        (8.4, 9.0, 10.1),
    ),
    SpokenLine(
        "sadness",
        11.2,
        14.6,
        11.95,
        # Nobody came home before five.
        _phones(
            "N:85 OW:130 B:80 AA:125 D:60 IY:130 K:95 EY:140 M:110 HH:60 OW:190 M:120 SIL:110 "
            "B:80 IH:80 F:95 AO:130 R:90 F:110 AY:260 V:130"
        ),
        (12.1, 13.2),
    ),
)


def timed_phones() -> tuple[TimedPhone, ...]:
    """Return all sounds of the script with their times, without silences."""
    sounds = []
    for line in LINES:
        time = line.speech
        for phone, duration in line.phones:
            stop = time + duration / 1000.0
            if phone != "SIL":
                sounds.append(TimedPhone(phone, time, stop, line.emotion))
            time = stop
    return tuple(sounds)


def spoken_phones() -> PhoneTrack:
    """Return sounds, silences and moods on the capture's clock."""
    phones: list[Span] = []
    end = 0.0
    for sound in timed_phones():
        if sound.start > end:
            phones.append(Span(end, sound.start, SILENCE))
        phones.append(Span(sound.start, sound.stop, sound.phone))
        end = sound.stop
    return PhoneTrack(
        (*phones, Span(end, DURATION_SECONDS, SILENCE)),
        (),
        tuple(Span(line.start, line.stop, line.emotion) for line in LINES),
        DURATION_SECONDS,
    )


def both(**weights: float) -> dict[str, float]:
    """Return weights of the left and the right side of each shape."""
    return {name + side: value for name, value in weights.items() for side in ("Left", "Right")}


VISEME_SHAPES: Mapping[str, Weights] = {
    "PP": both(mouthPress=0.38) | {"mouthRollLower": 0.16, "mouthRollUpper": 0.14, "jawOpen": 0.11},
    "FF": both(mouthUpperUp=0.20)
    | {"jawOpen": 0.07, "mouthRollLower": 0.62, "mouthShrugLower": 0.22},
    "TH": both(mouthLowerDown=0.22, mouthUpperUp=0.12) | {"jawOpen": 0.13, "tongueOut": 0.12},
    "DD": both(mouthUpperUp=0.12, mouthLowerDown=0.22) | {"jawOpen": 0.12},
    "KK": both(mouthLowerDown=0.14) | {"jawOpen": 0.18},
    "CH": {"mouthFunnel": 0.58, "jawOpen": 0.09, "mouthPucker": 0.15},
    "SS": both(mouthStretch=0.22, mouthSmile=0.08, mouthLowerDown=0.34, mouthUpperUp=0.14)
    | {"jawOpen": 0.04},
    "NN": both(mouthUpperUp=0.10, mouthLowerDown=0.18) | {"jawOpen": 0.10},
    "RR": {"mouthFunnel": 0.34, "mouthPucker": 0.22, "jawOpen": 0.12},
    "AA": both(mouthLowerDown=0.18, mouthUpperUp=0.14) | {"jawOpen": 0.60},
    "EH": both(mouthStretch=0.20, mouthLowerDown=0.26, mouthUpperUp=0.16) | {"jawOpen": 0.37},
    "IY": both(mouthSmile=0.18, mouthStretch=0.30, mouthLowerDown=0.30, mouthUpperUp=0.16)
    | {"jawOpen": 0.12},
    "OH": {"mouthFunnel": 0.48, "jawOpen": 0.44, "mouthPucker": 0.10},
    "UU": {"mouthPucker": 0.68, "mouthFunnel": 0.24, "jawOpen": 0.12},
}
"""Weights of each viseme."""

VISEME_OF_PHONE: Mapping[str, str] = {
    **dict.fromkeys(("P", "B", "M"), "PP"),
    **dict.fromkeys(("F", "V"), "FF"),
    **dict.fromkeys(("TH", "DH"), "TH"),
    **dict.fromkeys(("T", "D"), "DD"),
    **dict.fromkeys(("K", "G", "NG", "HH"), "KK"),
    **dict.fromkeys(("CH", "JH", "SH", "ZH"), "CH"),
    **dict.fromkeys(("S", "Z"), "SS"),
    **dict.fromkeys(("N", "L"), "NN"),
    **dict.fromkeys(("R", "ER"), "RR"),
    **dict.fromkeys(("AA", "AY", "AW"), "AA"),
    **dict.fromkeys(("AE", "EH", "EY", "AH", "UH"), "EH"),
    **dict.fromkeys(("IY", "IH", "Y"), "IY"),
    **dict.fromkeys(("AO", "OW", "OY"), "OH"),
    **dict.fromkeys(("UW", "W"), "UU"),
}

GLIDES: Mapping[str, str] = {"AW": "UU", "AY": "IY", "OW": "UU", "EY": "IY", "OY": "IY"}
"""Viseme of the second half of a diphthong."""

EMOTIONS: Mapping[str, Weights] = {
    "neutral": {},
    "happiness": both(
        mouthSmile=0.78,
        cheekSquint=0.62,
        mouthUpperUp=0.20,
        mouthDimple=0.22,
        eyeSquint=0.16,
        browOuterUp=0.24,
    )
    | {"jawOpen": 0.05, "browInnerUp": 0.12},
    "anger": both(
        browDown=0.95,
        noseSneer=0.48,
        eyeSquint=0.46,
        mouthPress=0.40,
        mouthFrown=0.34,
        mouthUpperUp=0.12,
    )
    | {"jawForward": 0.26, "mouthShrugLower": 0.20, "mouthRollUpper": 0.10},
    "sadness": both(
        mouthFrown=0.62,
        browDown=0.16,
        mouthStretch=0.14,
        eyeLookDown=0.34,
        eyeSquint=0.10,
        mouthDimple=0.06,
    )
    | {"browInnerUp": 0.92, "mouthShrugLower": 0.42, "mouthRollLower": 0.12},
}
"""Weights of each mood at full strength."""
