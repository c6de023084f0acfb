"""Names of the same motion, as rigs and tools write them."""

import pytest

from usdface.model.retarget.name_matching import match_names
from usdface.model.retarget.shape_names import motion_and_side
from usdface.model.retarget.shape_vocabulary import ARKIT


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("EyeBlinkLeft", ("eyeblink", "L")),
        ("eyeBlink_L", ("eyeblink", "L")),
        ("L_eye_blink", ("eyeblink", "L")),
        ("AU45_blink_left", ("eyeblink", "L")),
        ("blink_R", ("eyeblink", "R")),
        ("head:eyeBlinkRight", ("eyeblink", "R")),
        ("AU12_R", ("mouthsmile", "R")),
        ("lipCornerPuller_L", ("mouthsmile", "L")),
        ("AU_26", ("jawopen", "")),
        ("JAWOPEN", ("jawopen", "")),
        ("ctrl_expressions_mouthcornerpulll", ("mouthsmile", "L")),
        ("eyeBlink.L", ("eyeblink", "L")),
        ("Eye_L_Look_R", ("eyelookin", "L")),
        ("EYES_LOOK_LEFT_R", ("eyelookin", "R")),
        ("mouth_stretch_c", ("jawopen", "")),
        ("eyebrows-left-extern-up", ("browouterup", "L")),
        ("Mouth_Roll_In_Upper_L", ("mouthrollupper", "L")),
        ("jawLeft", ("jawleft", "")),
        ("mouth_R", ("mouthright", "")),
        ("browInnerUp", ("browinnerup", "")),
        ("cheekRaiser_L", ("cheeksquint", "L")),
        ("bs_noseSneer_R", ("nosesneer", "R")),
        ("face_l_corners_up", ("mouthsmile", "L")),
        ("face_r_corners_dn", ("mouthfrown", "R")),
        ("face_l_out_brow_up", ("browouterup", "L")),
        ("face_r_eyeBall_dn", ("eyelookdown", "R")),
        ("jaw_dn", ("jawopen", "")),
        ("R_lidCls", ("eyeblink", "R")),
        ("jawDrp", ("jawopen", "")),
        ("chk_sqnt_lf", ("cheeksquint", "L")),
        ("mthFrwn_R", ("mouthfrown", "R")),
        ("L_bro_Dn", ("browdown", "L")),
        ("mth_prs", ("mouthprs", "")),  # press, or purse
        ("l", ("l", "")),
        ("", ("", "")),
    ],
)
def test_a_name_is_a_motion_and_a_side(name: str, meaning: tuple[str, str]) -> None:
    assert motion_and_side(name) == meaning


def test_arkit_and_its_other_spelling_match_one_to_one() -> None:
    matches = match_names(
        ("EyeBlinkLeft", "EyeBlinkRight", "JawOpen"), ("jawOpen", "eyeBlink_R")
    ).matches
    assert [(m.name, m.target) for m in matches] == [
        ("EyeBlinkRight", (("eyeBlink_R", 1.0),)),
        ("JawOpen", (("jawOpen", 1.0),)),
    ]


def test_one_shape_drives_both_halves_and_two_halves_one_shape() -> None:
    (whole,) = match_names(("browInnerUp",), ("browInnerUp_L", "browInnerUp_R")).matches
    assert whole.target == (("browInnerUp_L", 1.0), ("browInnerUp_R", 1.0))
    halves = match_names(("cheekPuff_L", "cheekPuff_R"), ("cheekPuff",)).matches
    assert sum(match.target[0][1] for match in halves) == 1.0


def test_a_shape_that_opens_the_jaw_alone_counts_before_a_vowel() -> None:
    (jaw,) = match_names(("jawOpen",), ("A_mouth", "jaw_dn")).matches
    assert jaw.target == (("jaw_dn", 1.0),)


def test_left_is_never_right() -> None:
    assert match_names(("mouthSmileLeft",), ("mouthSmile_R",)).matches == ()
    assert match_names(("jawLeft",), ("jawRight",)).matches == ()


def test_every_arkit_shape_has_its_own_meaning() -> None:
    assert len(ARKIT) == 52
    assert len({motion_and_side(name) for name in ARKIT}) == 52
    assert all(match.source == match.target for match in match_names(ARKIT, ARKIT).matches)
