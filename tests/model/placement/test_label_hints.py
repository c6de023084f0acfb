import pytest

from usdface.model.placement.label_hints import (
    is_on_headgear,
    label_hint,
    mirror_partners,
    mirrored_label,
    side_of_label,
    skin_motion_mm,
)


@pytest.mark.parametrize(
    ("label", "side"),
    [
        ("Leye_Up", "L"),
        ("Reyebrow_Outside", "R"),
        ("Mouth_Lend", "L"),
        ("Mouth_UpR1", "R"),
        ("brow_L2", "L"),
        ("left_brow_inner", "L"),
        ("chin_r", "R"),
        ("RightCheek", "R"),
        ("LForehead", "L"),
        ("RFHD", "R"),
        ("LFHEAD1", "L"),
        ("LUpperLip", "L"),
        ("RLowerLid", "R"),
        ("LeftOrbi1", "L"),
        ("RBRO2", "R"),
        ("LC7", "L"),
        ("Mouth_Up", ""),
        ("lip_upper", ""),
        ("lid_lower", ""),
        ("Chin", ""),
        ("R000", ""),
        ("Lower", ""),
        ("cheekuper", ""),
        ("BROW_INNER_L", "L"),
        ("NOSTRIL_R", "R"),
        ("UPPERR", "R"),
        ("EYEL2", "L"),
        ("LIP_UPPER", ""),
        ("HEAD_CENTER1", ""),
        ("chin_cleft", ""),
    ],
)
def test_a_side_is_read_where_a_label_names_one(label: str, side: str) -> None:
    assert side_of_label(label) == side


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("Leye_Up", "Reye_Up"),
        ("Mouth_UpL1", "Mouth_UpR1"),
        ("left brow", "right brow"),
        ("LID_UPPER_L", "LID_UPPER_R"),
    ],
)
def test_the_label_of_the_other_side_is_found_both_ways(left: str, right: str) -> None:
    assert right in mirrored_label(left)
    assert left in mirrored_label(right)
    assert mirrored_label("Chin") == ()


@pytest.mark.parametrize(
    ("label", "region", "landmarks"),
    [
        ("NoseHead", "nose", ("nose_tip",)),
        ("NoseTop", "bridge", ("nose_bridge",)),
        ("Eyebrow_Center", "brow", ("brow_centre",)),
        ("Reye_Outside", "eye corner", ("eye_outer_R",)),
        ("Mouth_UpL1", "mouth", ("lip_upper", "mouth_L")),
        ("LBrowIn", "brow", ("brow_inner_L",)),
        ("LMidBrow", "brow", ("brow_middle_L",)),
        ("RLowLip", "mouth", ("lip_lower", "mouth_R")),
        ("LNSTRL", "nose", ()),
        ("RFHEAD2", "forehead", ()),
        ("RUPLID_OUT", "lid", ("lid_crease_R",)),
        ("LLOLID_IN", "lid", ("lid_lower_L",)),
        ("LOLIP_MID", "mouth", ("lip_lower",)),
        ("MOU3", "mouth", ()),
        ("RC3", "cheek", ()),
        ("Root1", "", ()),
        ("lid_L3", "eye", ("lid_crease_L", "lid_lower_L")),
        ("ForeHead_M", "forehead", ()),
        ("F017", "", ()),
    ],
)
def test_a_label_names_a_part_and_at_times_a_landmark(
    label: str, region: str, landmarks: tuple[str, ...]
) -> None:
    hint = label_hint(label)
    assert (hint.region, hint.landmarks) == (region, landmarks)


def test_skin_of_the_skull_moves_least_and_lips_most() -> None:
    bridge, brow, lip = skin_motion_mm(("NoseTop", "Leyebrow_M", "Mouth_Up"))
    assert bridge < 1 < brow < lip


def test_what_is_worn_is_neither_forehead_ear_nor_temple() -> None:
    worn = ("head_1", "Headband_L", "forehead_band_2", "skull", "cap_R", "HEAD4")
    assert all(map(is_on_headgear, worn))
    skin = ("ForeHead_M", "temple_L1", "ear_R", "Rear", "brow_L2", "cheek_1", "nose", "m12", "")
    assert not any(map(is_on_headgear, skin))


def test_partners_are_found_whatever_their_case() -> None:
    labels = ("Lcheek_Up", "Rcheek_up", "Chin", "brow_L1", "brow_R1", "Leye_Up")
    assert mirror_partners(labels) == {
        "Lcheek_Up": "Rcheek_up",
        "Rcheek_up": "Lcheek_Up",
        "brow_L1": "brow_R1",
        "brow_R1": "brow_L1",
    }
