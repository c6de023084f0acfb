"""Names of the same motions in facial rigs and tools: tables with their sources.

A line is ``motion: phrase | phrase``. Phrases are words in any order, normalised by `WORDS`, or
literal words in order after ``=``; a word in brackets is optional. Motions are ARKit's, without
capitals; ``motion/upper`` is one row of the lips, and ``+`` joins motions of one shape. Phrases
contain no sides, except for motions to a side (`jaw left`).
"""

ARKIT = """
eyeBlinkLeft eyeLookDownLeft eyeLookInLeft eyeLookOutLeft eyeLookUpLeft eyeSquintLeft eyeWideLeft
eyeBlinkRight eyeLookDownRight eyeLookInRight eyeLookOutRight eyeLookUpRight eyeSquintRight
eyeWideRight jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft
mouthRight mouthSmileLeft mouthSmileRight mouthFrownLeft mouthFrownRight mouthDimpleLeft
mouthDimpleRight mouthStretchLeft mouthStretchRight mouthRollLower mouthRollUpper mouthShrugLower
mouthShrugUpper mouthPressLeft mouthPressRight mouthLowerDownLeft mouthLowerDownRight
mouthUpperUpLeft mouthUpperUpRight browDownLeft browDownRight browInnerUp browOuterUpLeft
browOuterUpRight cheekPuff cheekSquintLeft cheekSquintRight noseSneerLeft noseSneerRight tongueOut
""".split()
"""Apple, `ARFaceAnchor.BlendShapeLocation`. Live Link Face, MediaPipe, Audio2Face, Face Cap and ICT
use these names, with other side words and capitals."""

VOCABULARIES = (
    # ARKit: https://developer.apple.com/documentation/arkit/arfaceanchor/blendshapelocation
    (
        0,
        """
        eyeblink: eye blink
        eyesquint: eye squint
        eyewide: eye wide
        jawforward: jaw forward
        jawleft: jaw left
        jawright: jaw right
        jawopen: jaw open
        mouthclose: mouth close
        mouthfunnel: mouth funnel
        mouthpucker: mouth pucker
        mouthleft: mouth left
        mouthright: mouth right
        mouthsmile: mouth smile
        mouthfrown: mouth frown
        mouthdimple: mouth dimple
        mouthstretch: mouth stretch
        mouthroll: mouth roll
        mouthshrug: mouth shrug
        mouthpress: mouth press
        mouthlowerdown: mouth lower down
        mouthupperup: mouth upper raise
        browdown: brow down
        browinnerup: brow inner raise
        browouterup: brow outer raise
        cheekpuff: cheek puff
        cheeksquint: cheek squint
        nosesneer: nose sneer
        tongueout: tongue out
        """,
    ),
    # FACS: Ekman, Friesen and Hager, Facial Action Coding System: The Manual, 2002; as Meta's face
    # tracking writes it:
    # https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrFaceExpressionFB.html
    (
        1,
        """
        browdown: brow lower
        eyewide: [eye] upper lid raise
        cheeksquint: cheek raise
        eyesquint: [eye] lid tight
        eyeblink: eye close
        nosesneer: nose wrinkle
        mouthsmile: mouth corner pull
        mouthdimple: dimple
        mouthfrown: mouth corner depress
        mouthlowerdown: mouth lower depress
        mouthshrug/lower: [mouth] chin raise
        mouthroll: mouth suck
        mouthclose: mouth toward
        jawopen: jaw drop
        jawforward: jaw thrust
        jawleft: jaw side left
        jawright: jaw side right
        mouthleft: mouth side left
        mouthright: mouth side right
        cheekpuff: cheek blow
        tongueout: tongue show
        """,
    ),
    # Character Creator 4:
    # https://manual.reallusion.com/Character-Creator-4/Content/ENU/4.0/16-Facial-Expression/Extended-Facial-Blendshapes.htm
    (
        1,
        """
        browdown: brow drop
        mouthroll: mouth roll in
        mouthfunnel/upper: mouth funnel raise
        mouthfunnel/lower: mouth funnel down
        mouthpucker/upper: mouth pucker raise
        mouthpucker/lower: mouth pucker down
        """,
    ),
    # MetaHuman: raw controls `CTRL_expressions_*` of Epic's MetaHuman rig, and its pose asset
    # PA_MetaHuman_ARKit_Mapping, as listed in https://github.com/Dylanyz/ARKitRemap
    (
        1,
        """
        eyesquint: eye squint inner
        cheeksquint: eye cheek raise
        mouthpucker: mouth purse
        mouthclose: mouth together
        mouthlipspress: mouth lips press
        cheekpuff: mouth cheek blow
        mouthshrug/lower: jaw chin raise
        browinnerup: brow raise in
        """,
    ),
    # MPFB: expression units of MakeHuman and MPFB: https://github.com/makehumancommunity/mpfb2,
    # data/targets/expression/units
    (
        1,
        """
        eyewide: eye open raise
        eyesquint: eye slit
        browinnerup+browouterup: brow raise
        jawopen: mouth open
        mouthpress: mouth compression
        mouthfrown: mouth depression
        mouthstretch: mouth retraction
        mouthpucker: mouth pursing
        mouthfunnel: mouth protusion
        nosesneer: nose elevation
        """,
    ),
    # FACEGOOD: https://github.com/FACEGOOD/FACEGOOD-Audio2Face, rig `shirley`; its users' table to
    # ARKit
    (
        1,
        """
        jawopen: mouth stretch c
        mouthclose: mouth chew
        browinnerup: brow raise c
        """,
    ),
    # Faceshift: shapes of faceshift studio, from which ARKit's descend, as Vircadia lists them:
    # https://docs.vircadia.com/create/avatars/avatar-standards.html
    (
        2,
        """
        eyelookdown: eye down
        eyelookup: eye raise
        eyelookin: eye in
        eyelookout: eye out
        browdown: brow d
        browinnerup: brow u c
        browouterup: brow u
        mouthclose: jaw chew
        mouthroll/upper: =lips upper close
        mouthroll/lower: =lips lower close
        """,
    ),
    # VRM and VRoid:
    # https://github.com/vrm-c/vrm-specification/blob/master/specification/VRMC_vrm-1.0/expressions.md;
    # VRoid Studio's `Fcl_*`
    (
        2,
        """
        eyewide: eye spread
        browdown: brow angry
        browinnerup+browouterup: brow surprised
        browinnerup: brow sorrow
        mouthsmile: mouth fun
        """,
    ),
    # VRM and VRoid, vowels: as above: the mouth of an open vowel, where no shape opens the jaw
    # alone
    (
        4,
        """
        jawopen: mouth a
        """,
    ),
    # English: words that animators use for these motions
    (
        3,
        """
        eyeblink: blink | wink | lid close | lid blink | lid down
        eyesquint: squint | eye narrow | eye squeeze | eye tight | lid squint
        eyewide: eye open wide | eye open | lid wide | lid raise | upper lid raise
        jawopen: open mouth | mouth open | jaw down
        jawforward: jaw out | jaw protrude | chin forward
        jawleft: jaw slide left | jaw shift left | jaw move left | jaw swing left
        jawright: jaw slide right | jaw shift right | jaw move right | jaw swing right
        mouthleft: mouth slide left | mouth shift left | mouth move left | mouth swing left
        mouthright: mouth slide right | mouth shift right | mouth move right | mouth swing right
        mouthpucker: pucker | pout | mouth pout | kiss | mouth kiss | purse
        mouthfunnel: funnel
        mouthsmile: smile | grin | mouth grin | [mouth] corner raise | mouth happy
        mouthfrown: frown | [mouth] corner down | mouth sad
        mouthdimple: mouth corner dimple
        mouthstretch: mouth wide | [mouth] corner stretch | mouth widen | [mouth] corner out
        mouthroll: mouth tuck | mouth in | mouth inside | mouth bite
        mouthpress: mouth compress | mouth corner press
        mouthupperup: mouth upper open
        mouthlowerdown: mouth lower open
        browdown: brow frown | brow angry | brow furrow
        browinnerup: brow centre raise | brow mid raise | brow in raise
        browouterup: brow out raise
        cheekpuff: puff | cheek inflate
        nosesneer: sneer | snarl | nose raise | nose scrunch | nose crinkle | nose snarl
        tongueout: tongue stick out
        """,
    ),
)
"""Rank and phrases of each source: of two shapes with the same meaning, the one of lower rank is
used."""

ACTION_UNITS = {
    1: "browinnerup",
    2: "browouterup",
    4: "browdown",
    5: "eyewide",
    6: "cheeksquint",
    7: "eyesquint",
    8: "mouthclose",
    9: "nosesneer",
    10: "mouthupperup",
    12: "mouthsmile",
    14: "mouthdimple",
    15: "mouthfrown",
    16: "mouthlowerdown",
    17: "mouthshrug/lower",
    18: "mouthpucker",
    19: "tongueout",
    20: "mouthstretch",
    22: "mouthfunnel",
    24: "mouthpress",
    26: "jawopen",
    28: "mouthroll",
    29: "jawforward",
    34: "cheekpuff",
    45: "eyeblink",
    61: "lookleft",
    62: "lookright",
    63: "lookup",
    64: "lookdown",
}
"""ARKit's motion of each action unit of Ekman, Friesen and Hager (2002)."""

WEAKER_UNITS = {27: "jawopen", 33: "cheekpuff", 43: "eyeblink", 46: "eyeblink"}
"""Units of the same motion as one in `ACTION_UNITS`, which has precedence."""

SIDE_WORDS = {
    **dict.fromkeys(("l", "left", "lf", "lft", "lt"), "L"),
    **dict.fromkeys(("r", "right", "rt", "rgt", "rg"), "R"),
}

CENTRES = ("c", "m", "centre", "center", "ctr", "mid", "middle", "both")

ROWS = {
    **dict.fromkeys(("upper", "top", "u", "t"), "U"),
    **dict.fromkeys(("lower", "bottom", "d", "b"), "D"),
}

ROWED = (
    *("mouthfunnel", "mouthpucker", "mouthroll", "mouthshrug", "mouthpress", "mouthclose"),
    *("mouthleft", "mouthright", "mouthlipspress", "mouthlipstowards"),
)
"""Motions with a shape for each lip in some rigs."""

FILLERS = frozenset(
    "bs blend blendshape blendshapes shape shapes morph morphs target face facial facs fac action "
    "unit au fcl ctrl ball expression expressions weight weights skin".split()
)
"""Words without meaning for the motion."""

WORDS = {
    **dict.fromkeys(("eyes", "eyeball", "eyeballs"), "eye"),
    **dict.fromkeys(("eyelid", "eyelids", "lids"), "lid"),
    **dict.fromkeys(("eyebrow", "eyebrows", "brows", "brw", "bro"), "brow"),
    **dict.fromkeys(("lip", "lips", "mth"), "mouth"),
    **dict.fromkeys(("corners",), "corner"),
    **dict.fromkeys(("dn", "dwn"), "down"),
    **dict.fromkeys(("cheeks",), "cheek"),
    **dict.fromkeys(("up", "raiser", "raised", "raises"), "raise"),
    **dict.fromkeys(("lowerer", "lowered", "lowers"), "lower"),
    **dict.fromkeys(("puller", "pulled"), "pull"),
    **dict.fromkeys(("depressor", "depressed"), "depress"),
    **dict.fromkeys(("tightener", "tighten", "tightened"), "tight"),
    **dict.fromkeys(("stretcher", "stretched"), "stretch"),
    **dict.fromkeys(("funneler", "funneled"), "funnel"),
    **dict.fromkeys(("puckerer", "puckered"), "pucker"),
    **dict.fromkeys(("pressor", "presser", "pressed"), "press"),
    **dict.fromkeys(("dimpler", "dimpled"), "dimple"),
    **dict.fromkeys(("wrinkler", "wrinkled"), "wrinkle"),
    **dict.fromkeys(("widen", "widened", "widener"), "wide"),
    **dict.fromkeys(("closed", "closure", "shut", "closing"), "close"),
    **dict.fromkeys(("opened", "opening"), "open"),
    **dict.fromkeys(("extern", "external", "outside"), "outer"),
    **dict.fromkeys(("intern", "internal"), "inner"),
    **dict.fromkeys(("fwd", "forwards"), "forward"),
    **dict.fromkeys(("sideways", "sideway"), "side"),
    **dict.fromkeys(("upr",), "upper"),
    **dict.fromkeys(("lwr", "lowr"), "lower"),
    **dict.fromkeys(("smiles", "smiling"), "smile"),
    **dict.fromkeys(("purses", "pursed"), "purse"),
    **dict.fromkeys(("sucked", "sucker"), "suck"),
    **dict.fromkeys(("sneerer",), "sneer"),
    **dict.fromkeys(("puffed", "puffer"), "puff"),
    **dict.fromkeys(("looks", "gaze"), "look"),
}
"""Normal forms of words."""

METAHUMAN_MARKS = frozenset(
    {
        frozenset({"brow", "raise", "in"}),
        frozenset({"brow", "lateral"}),
        frozenset({"mouth", "towards"}),
        frozenset({"mouth", "purse"}),
        frozenset({"mouth", "lower", "roll", "in"}),
    }
)
"""Phrases of MetaHuman's raw controls; two of them identify such a rig."""

FACEGOOD_MARKS = frozenset({frozenset({"mouth", "chew"}), frozenset({"eye", "close", "tight"})})
"""Phrases of FACEGOOD's rig; both together identify it."""

FACEGOOD_SECOND = ("eyeblink", "eyelookdown")
"""Motions of which FACEGOOD has two numbered shapes. The second is ARKit's, by its makers' table:
https://github.com/FACEGOOD/FACEGOOD-Audio2Face, `Voice2Face_blendshape2ARkit.xlsx`."""

METAHUMAN_POSES = (
    ("browinnerup", "browlateral", 1.0),
    ("browouterup", "browinnerup", 1.0),
    ("cheekpuff", "mouthblow", 1.0),
    ("mouthpucker", "mouthtowards", 0.412),
    ("mouthpucker", "mouthfunnel", 0.752),
    ("mouthroll/lower", "mouthroll/upper", 0.499),
    ("tongueout", "tongueout", 0.769),
    ("tongueout", "tonguedown", 0.826),
    ("tongueout", "tonguewide", 0.628),
    ("tongueout", "tonguerolldown", 0.247),
)
"""Further controls of Epic's poses, in addition to the control of the same motion at 1: ARKit's
motion, the control's motion, its weight. Omitted: values of a few hundredths on one side only, and
the default of 1 for `noseWrinkleUpper`."""
