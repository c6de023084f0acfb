"""Two people in numbers: the proportions and colours from which the built-in heads are sculpted.

Millimetres, Y up, Z forward, X towards the person's left; the origin lies between the eyes, on the
axis through the ears. Only the left half is described: the right one mirrors it exactly.
"""

from dataclasses import dataclass, field

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Skull:
    """Bone and fat under the skin: centres and radii of the blobs that make the bare head."""

    cranium: Vec = (0.0, 38.0, -12.0)
    cranium_radii: Vec = (76.0, 80.0, 94.0)
    face: Vec = (0.0, -28.0, 20.0)
    face_radii: Vec = (56.5, 76.0, 66.0)
    jaw_angle: Vec = (38.5, -62.0, 0.0)
    jaw_radius: float = 12.5
    chin: Vec = (0.0, -99.0, 68.0)
    chin_radii: Vec = (15.0, 13.0, 15.0)
    cheekbone: Vec = (40.0, -18.0, 52.0)
    cheekbone_radii: Vec = (20.0, 16.0, 19.0)
    cheek: Vec = (31.0, -42.0, 54.5)
    cheek_radii: Vec = (23.0, 23.0, 24.0)
    jowl: Vec = (30.0, -64.0, 38.0)
    jowl_radii: Vec = (16.5, 22.0, 26.0)
    muzzle: Vec = (0.0, -70.0, 58.0)
    muzzle_radii: Vec = (30.0, 26.0, 28.0)
    brow_height: float = 22.0
    brow_depth: float = 75.0
    brow_radius: float = 9.0
    neck_front: float = 12.0
    neck_back: float = -56.0
    neck_half: float = 36.0


@dataclass(frozen=True)
class Eye:
    """The eyeball and the opening of the lids over it."""

    center: Vec = (31.0, 0.0, 59.0)
    radius: float = 20.5
    half_width: float = 17.0
    open_up: float = 9.0
    open_down: float = 7.5
    tilt: float = 1.2
    socket: float = 9.0
    iris: float = 0.50


@dataclass(frozen=True)
class Nose:
    """The nose, from its root between the eyes to the base on the lip."""

    root: tuple[float, float] = (2.0, 82.0)
    tip: tuple[float, float] = (-35.5, 102.5)
    base: tuple[float, float] = (-46.0, 86.5)
    bridge_radius: float = 5.5
    tip_radius: float = 7.6
    wing: Vec = (9.0, -40.0, 88.0)
    wing_radii: Vec = (5.0, 5.6, 8.0)


@dataclass(frozen=True)
class Mouth:
    """Where the lips meet, how high each lip is and how far it stands out."""

    height: float = -67.0
    half_width: float = 23.0
    curve: float = 3.0
    upper: float = 6.5
    lower: float = 9.0
    fullness: float = 4.4


@dataclass(frozen=True)
class HeadColors:
    """Linear display colours."""

    skin: Vec = (0.68, 0.40, 0.285)
    lip: Vec = (0.56, 0.19, 0.165)
    iris: Vec = (0.075, 0.175, 0.095)
    hair: Vec = (0.15, 0.058, 0.022)
    brow: Vec = (0.075, 0.030, 0.013)


@dataclass(frozen=True)
class Style:
    """One person: everything `usdface.demo.head.make_head` needs to know."""

    name: str
    skull: Skull = field(default_factory=Skull)
    eye: Eye = field(default_factory=Eye)
    nose: Nose = field(default_factory=Nose)
    mouth: Mouth = field(default_factory=Mouth)
    palette: HeadColors = field(default_factory=HeadColors)


CHARACTER = Style("character")
"""The rig: large eyes, small nose, a narrow chin."""

ACTOR = Style(
    "actor",
    skull=Skull(
        cranium=(0.0, 40.0, -14.0),
        cranium_radii=(75.0, 79.0, 95.0),
        face=(0.0, -32.0, 18.0),
        face_radii=(59.0, 82.0, 67.0),
        jaw_angle=(43.0, -72.0, 0.0),
        jaw_radius=14.0,
        chin=(0.0, -111.0, 67.0),
        chin_radii=(19.0, 14.0, 16.0),
        cheekbone=(43.0, -22.0, 50.0),
        cheekbone_radii=(19.0, 15.0, 18.0),
        cheek=(30.0, -52.0, 52.0),
        cheek_radii=(22.0, 26.0, 24.0),
        jowl=(33.0, -70.0, 34.0),
        jowl_radii=(17.0, 25.0, 27.0),
        muzzle=(0.0, -77.0, 57.0),
        muzzle_radii=(31.0, 27.0, 28.0),
        brow_height=18.0,
        brow_depth=77.0,
        brow_radius=10.5,
        neck_front=16.0,
        neck_back=-60.0,
        neck_half=46.0,
    ),
    eye=Eye(
        center=(31.5, 0.0, 61.0),
        radius=16.5,
        half_width=14.6,
        open_up=6.4,
        open_down=5.2,
        tilt=0.6,
        socket=10.0,
        iris=0.47,
    ),
    nose=Nose(
        root=(2.0, 84.0),
        tip=(-43.0, 107.0),
        base=(-51.5, 89.0),
        bridge_radius=7.5,
        tip_radius=9.5,
        wing=(11.0, -46.5, 91.0),
        wing_radii=(6.0, 7.0, 10.0),
    ),
    mouth=Mouth(height=-75.5, half_width=25.0, curve=0.8, upper=4.8, lower=7.0, fullness=3.6),
    palette=HeadColors(
        skin=(0.60, 0.345, 0.24),
        lip=(0.47, 0.175, 0.145),
        iris=(0.07, 0.14, 0.24),
        hair=(0.030, 0.019, 0.013),
        brow=(0.022, 0.014, 0.010),
    ),
)
"""The performer: longer nose and jaw, smaller eyes, thinner lips."""
