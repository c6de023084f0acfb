"""Shapes of two rigs by what their names mean, one to one, both sides alike."""

import random
import re

import numpy as np
import pytest

from benchmarks._published_names import PUBLISHED, Published
from usdface.model.retarget.name_matching import match_names, transfer_by_names, transfer_matrix
from usdface.model.retarget.shape_names import read_meanings
from usdface.model.retarget.shape_vocabulary import ARKIT

METAHUMAN = next(each for each in PUBLISHED if each.name == "MetaHuman").names()


def matched(names: list[str] | tuple[str, ...]) -> set[tuple[str, str]]:
    return {
        (match.name, name)
        for match in match_names(ARKIT, names).matches
        for name, _ in match.target
    }


@pytest.mark.parametrize("given", PUBLISHED, ids=lambda each: each.name)
def test_published_names_find_their_counterparts_and_no_other(given: Published) -> None:
    found, wanted = matched(given.names()), given.pairs()
    assert found <= wanted
    names = {theirs for _, theirs in wanted}
    assert len(names & {theirs for _, theirs in found}) >= 0.96 * len(names)


@pytest.mark.parametrize(
    "prefix", ["hero_face_bs_", "CTRL_expressions_", "c_", "mouth_", "L_", "blendShape1.", "x7q_"]
)
def test_what_all_names_share_says_nothing(prefix: str) -> None:
    dressed = [prefix + name for name in ARKIT]
    assert matched(dressed) == set(zip(ARKIT, dressed, strict=True))


def test_shapes_of_one_meaning_are_told_apart_by_names_that_differ_in_a_prefix() -> None:
    own = ("cheekSquint_L", "cheekRaiser_L", "jawOpen")
    dressed = [f"head_GEO.{name}" for name in own]
    for source, target in ((own, dressed), (dressed, own)):
        transfer = transfer_by_names(source, target)
        np.testing.assert_array_equal(transfer.matrix, np.eye(3))


@pytest.mark.parametrize(("one", "other"), [("L_", "R_"), ("jaw_", "mouth_")])
def test_a_prefix_that_tells_shapes_apart_is_a_difference(one: str, other: str) -> None:
    for parts in (("smile", "eyeBlink"), ("left", "right")):
        source, target = ([start + part for part in parts] for start in (one, other))
        assert not transfer_by_names(source, target).matched


def test_a_shared_word_that_is_part_of_the_names_stays() -> None:
    """Of a rig of mouth shapes alone, `mouth` is no prefix; nor is a side that all are of."""
    mouths = [name for name in ARKIT if name.startswith("mouth")]
    assert matched(mouths) == {(name, name) for name in mouths}
    left = ["eyeBlink_L", "browDown_L", "cheekSquint_L"]
    assert {match.name[-4:] for match in match_names(ARKIT, left).matches} == {"Left"}


def test_shapes_that_could_be_either_are_named_not_guessed() -> None:
    found = match_names(ARKIT, ["eye_blink1_l", "eye_blink2_l", "eyeBlinkRight", "jawOpen"])
    assert {match.name for match in found.matches} == {"jawOpen"}
    assert any(each.startswith("eye_blink1_l: ") for each in found.ambiguous)
    assert any(each.startswith("eyeBlinkRight: its other side") for each in found.ambiguous)


def test_of_numbered_shapes_the_second_counts_where_their_makers_say_so() -> None:
    facegood = next(each for each in PUBLISHED if each.name == "FACEGOOD").names()
    taken = {name for name in ("eye_blink2_l", "eye_lookDown2_r") if name in facegood}
    assert taken < {name for _, name in matched(facegood)}
    without = [name for name in facegood if "chew" not in name]
    assert not taken & {name for _, name in matched(without)}


def test_sides_stand_at_the_end_of_names_without_capitals() -> None:
    """In `eyelookupr`, `upr` is no upper lip."""
    glued = [
        re.sub("(?<!^jaw)(Left|Right)$", lambda side: side[0][0], name).lower() for name in ARKIT
    ]
    assert matched(glued) == set(zip(ARKIT, glued, strict=True))


def test_names_in_other_scripts_are_not_the_same_name() -> None:
    assert not match_names(["口開", "▲"], ["まばたき", "ω"]).matches
    assert match_names(["口開"], ["口開_L", "口開_R"]).matches
    assert read_meanings(["Lächeln"])["Lächeln"].side == ""


def test_doubts_are_of_what_the_other_rig_has() -> None:
    twice = ["tongue_Scale_X", "tongue_Scale__X", "jawOpen", "mouth_open"]
    (note,) = match_names(twice, ARKIT).ambiguous
    assert note.startswith("mouth_open: ")
    assert len(match_names(twice, [*ARKIT, "tongue_scale_x"]).ambiguous) == 3


def test_the_better_known_name_wins_and_the_other_is_named() -> None:
    found = match_names(ARKIT, ["jawOpen", "mouth_open"])
    assert [(match.name, match.target) for match in found.matches] == [
        ("jawOpen", (("jawOpen", 1.0),))
    ]
    assert found.ambiguous == ("mouth_open: jawOpen of the target is used for that motion",)


def test_names_that_are_all_the_rigs_own_raise_no_doubts_of_its_others() -> None:
    """A table of some of a rig's own shapes is what it says; the rest of the rig is not asked."""
    whole, halves = "lower_lip_up", ("l_lower_lip_up", "r_lower_lip_up")
    assert match_names([whole, "jawOpen"], [whole, "jawOpen", *halves]).ambiguous == ()
    doubts = match_names(["lowerLipUp", "jawOpen"], [whole, "jawOpen", *halves]).ambiguous
    assert [each.split(":")[0] for each in doubts] == list(halves)


def test_both_sides_are_matched_alike_whatever_is_missing() -> None:
    rng = random.Random(0)
    one_sided = 0
    for _ in range(50):
        given = rng.choice(PUBLISHED)
        names = rng.sample(given.names(), len(given.names()) * 2 // 3)
        meanings = read_meanings(names)
        there = {each.cells for each in meanings.values()}
        ours = {match.name for match in match_names(ARKIT, names).matches}
        for name in ours:
            if name.endswith("Left") and name[:-4] + "Right" not in ours:
                cells = read_meanings(ARKIT)[name[:-4] + "Right"].cells
                assert cells not in there, (given.name, name)
                one_sided += 1
    assert one_sided


def test_arkit_through_metahuman_controls_comes_back() -> None:
    there = transfer_matrix(match_names(ARKIT, METAHUMAN).matches, ARKIT, METAHUMAN)
    back = transfer_matrix(match_names(METAHUMAN, ARKIT).matches, METAHUMAN, ARKIT)
    weights = np.random.default_rng(0).random((40, len(ARKIT)))
    np.testing.assert_allclose(weights @ there @ back, weights, atol=1e-6)
    pucker = dict(zip(METAHUMAN, there[ARKIT.index("mouthPucker")], strict=True))
    assert pucker["CTRL_expressions_mouthLipsPurseUL"] == 1.0
    assert pucker["CTRL_expressions_mouthFunnelDR"] == 0.752  # as Epic's pose asset has it


def test_weights_of_one_to_one_pairs_pass_to_the_last_bit() -> None:
    names = [f"rig_{name}" for name in reversed(ARKIT)]
    matrix = transfer_matrix(match_names(ARKIT, names).matches, ARKIT, names)
    weights = np.random.default_rng(0).random((9, len(ARKIT)))
    assert np.array_equal(weights @ matrix, weights[:, ::-1])
