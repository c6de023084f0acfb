"""Shapes of two rigs matched by their names: ARKit, ICT, FACS and what tools make of them.

A name is a motion and a side. ``EyeBlinkLeft``, ``eyeBlink_L``, ``L_eye_blink`` and
``AU45_blink_left`` are the same; so is an ``browInnerUp`` without a side and its two halves.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

_SIDES = {"left": "L", "l": "L", "lf": "L", "lt": "L", "right": "R", "r": "R", "rt": "R", "rg": "R"}

_SIDED_MOTIONS = ("jaw", "mouth", "tongue")
"""Motions to a side (`jawLeft`) rather than of one: the side belongs to the motion."""

_FILLERS = ("au", "bs", "blendshape", "shape", "face", "facs", "fac", "action", "unit")

_FACS: dict[str, str] = {
    "au1": "browinnerup",
    "au2": "browouterup",
    "au4": "browdown",
    "au5": "eyewide",
    "au6": "cheeksquint",
    "au7": "eyesquint",
    "au9": "nosesneer",
    "au10": "mouthupperup",
    "au12": "mouthsmile",
    "au14": "mouthdimple",
    "au15": "mouthfrown",
    "au16": "mouthlowerdown",
    "au17": "mouthshruglower",
    "au18": "mouthpucker",
    "au20": "mouthstretch",
    "au22": "mouthfunnel",
    "au24": "mouthpress",
    "au26": "jawopen",
    "au28": "mouthrolllower",
    "au29": "jawforward",
    "au33": "cheekpuff",
    "au34": "cheekpuff",
    "au43": "eyeblink",
    "au45": "eyeblink",
    "au61": "eyelookleft",
    "au62": "eyelookright",
    "au63": "eyelookup",
    "au64": "eyelookdown",
}
"""Action units of Ekman and Friesen (1978) by the motion that ARKit names."""

_SAME: dict[str, str] = {
    "innerbrowraiser": "browinnerup",
    "browraiserinner": "browinnerup",
    "browinnerraise": "browinnerup",
    "browraiseinner": "browinnerup",
    "outerbrowraiser": "browouterup",
    "browraiserouter": "browouterup",
    "browouterraise": "browouterup",
    "browraiseouter": "browouterup",
    "browlowerer": "browdown",
    "browlower": "browdown",
    "upperlidraiser": "eyewide",
    "eyewiden": "eyewide",
    "cheekraiser": "cheeksquint",
    "cheekraise": "cheeksquint",
    "lidtightener": "eyesquint",
    "blink": "eyeblink",
    "eyeclose": "eyeblink",
    "eyesclosed": "eyeblink",
    "eyeclosed": "eyeblink",
    "nosewrinkler": "nosesneer",
    "nosewrinkle": "nosesneer",
    "sneer": "nosesneer",
    "upperlipraiser": "mouthupperup",
    "lowerlipdepressor": "mouthlowerdown",
    "lipcornerpuller": "mouthsmile",
    "mouthcornerpull": "mouthsmile",
    "smile": "mouthsmile",
    "lipcornerdepressor": "mouthfrown",
    "mouthcornerdepress": "mouthfrown",
    "frown": "mouthfrown",
    "dimpler": "mouthdimple",
    "chinraiser": "mouthshruglower",
    "lippucker": "mouthpucker",
    "lippuckerer": "mouthpucker",
    "pucker": "mouthpucker",
    "lipstretcher": "mouthstretch",
    "lipfunneler": "mouthfunnel",
    "funnel": "mouthfunnel",
    "lippressor": "mouthpress",
    "lipsuck": "mouthrolllower",
    "jawdrop": "jawopen",
    "mouthopen": "jawopen",
    "jawthrust": "jawforward",
    "puff": "cheekpuff",
    "cheekpuffer": "cheekpuff",
}

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


@dataclass(frozen=True)
class NameMatch:
    """An expression that both rigs have by name."""

    name: str
    """For people."""
    source: tuple[tuple[str, float], ...]
    target: tuple[tuple[str, float], ...]
    """`source`, `target`: Shapes and their weights."""


def motion_and_side(name: str) -> tuple[str, str]:
    """Return what a shape does, in ARKit's words without capitals, and its side: L, R or none."""
    words = [word.lower() for word in _WORD.findall(name.split(":")[-1].split(".")[-1])]
    side = ""
    for place in (len(words) - 1, 0):
        if len(words) > 1 and words[place] in _SIDES:
            side = _SIDES[words.pop(place)]
            break
    unit = _action_unit(words)
    if unit in _FACS:
        return _FACS[unit], side
    stem = "".join(word for word in words if word not in _FILLERS and not word.isdigit())
    stem = _SAME.get(stem, stem)
    if side and stem in _SIDED_MOTIONS:
        return stem + ("left" if side == "L" else "right"), ""
    return stem, side


def match_names(source: Sequence[str], target: Sequence[str]) -> tuple[NameMatch, ...]:
    """Return the expressions that both rigs have, one pair for each source shape that matches.

    A shape without sides drives both halves of the other rig; of two halves each drives half of a
    shape without sides, so that together they drive it in full.
    """
    there = _by_motion(target)
    found = []
    for shape in source:
        motion, side = motion_and_side(shape)
        sides = there.get(motion, {})
        if side in sides:
            partners: tuple[tuple[str, float], ...] = ((sides[side], 1.0),)
        elif not side and {"L", "R"} <= sides.keys():
            partners = ((sides["L"], 1.0), (sides["R"], 1.0))
        elif side and "" in sides:
            partners = ((sides[""], 0.5),)
        else:
            continue
        found.append(NameMatch(shape, ((shape, 1.0),), partners))
    return tuple(found)


def _by_motion(names: Iterable[str]) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for name in names:
        motion, side = motion_and_side(name)
        found.setdefault(motion, {}).setdefault(side, name)
    return found


def _action_unit(words: list[str]) -> str:
    """Return ``au12`` for AU12, AU_12, AU012 and the like; empty when there is none."""
    for word, number in pairwise(words):
        if word == "au" and number.isdigit():
            return f"au{int(number)}"
    return ""
