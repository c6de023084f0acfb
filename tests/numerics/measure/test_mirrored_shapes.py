"""Left and right by name, and which shapes keep to their side."""

import numpy as np
import pytest
from scipy import sparse

from usdface.numerics.measure.face_regions import mirrored_shapes, sided_shapes


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("browDown_L", "browDown_R"),
        ("mouthSmileLeft", "mouthSmileRight"),
        ("left_brow_up", "right_brow_up"),
        ("LEFT_BLINK", "RIGHT_BLINK"),
        ("l_lid_close", "r_lid_close"),
        ("brow_l_01", "brow_r_01"),
        ("L-smile", "R-smile"),
        ("lBrow", "rBrow"),
        ("smileL", "smileR"),
        ("eyeLookInLeft", "eyeLookInRight"),
        ("Left.mouth.left", "Right.mouth.left"),
        ("smirk_shortLf", "smirk_shortRt"),
        ("LFT_stretch", "RGT_stretch"),
        ("parpadeoIzq", "parpadeoDer"),
        ("Auge_zu_li", "Auge_zu_re"),
        ("まばたき_左", "まばたき_右"),
    ],
)
def test_partners_find_each_other_in_any_order(left: str, right: str) -> None:
    names = [right, "jawOpen", left, "tongue"]
    assert mirrored_shapes(names).tolist() == [2, 1, 0, 3]


@pytest.mark.parametrize(
    "names",
    [
        ["lipRoll", "ripRoll"],  # a first letter is no side without a separator
        ["browDown_L"],
        ["cheekPuff", "cheekpuff"],
        ["ALL", "ARL", "ALR"],
        ["", "_"],
    ],
)
def test_names_without_a_partner_are_their_own(names: list[str]) -> None:
    assert mirrored_shapes(names).tolist() == list(range(len(names)))


def test_partners_are_an_involution() -> None:
    rng = np.random.default_rng(0)
    words = ["left", "right", "L", "R", "_", "brow", "Up"]
    names = sorted({"".join(rng.choice(words, rng.integers(1, 5))) for _ in range(400)})
    partner = mirrored_shapes(names)
    assert np.array_equal(partner[partner], np.arange(len(names)))


def test_a_smile_has_a_side_and_a_jaw_has_none() -> None:
    points = np.c_[np.linspace(-50, 50, 11), np.zeros(11), np.zeros(11)]
    offsets = np.zeros((4, 11, 3))
    offsets[0, 7:, 1] = 5  # on one side
    offsets[1, :4, 1] = 5  # on the other
    offsets[2, :, 0] = 5  # the whole jaw, to the left
    sided = sided_shapes(sparse.csr_array(offsets.reshape(4, -1)), points)
    assert sided.tolist() == [True, True, False, False]
