"""A take against its performer: what is said, what is refused, and how sessions count."""

from dataclasses import replace

import numpy as np
import pytest

from tests.numerics.registration.test_marker_application import GLUE, NEUTRAL, performance, seen
from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.mapping.take_neutral import TakeNeutral, compare_neutral

NAMES = tuple(f"m{i:02d}" for i in range(len(NEUTRAL)))
FRAMES = performance(0)
FACE = PerformerFace(NAMES, NAMES[:8], NEUTRAL, FRAMES, seen(FRAMES), "Kim", "monday")


def compare(
    positions: FloatArray, stated: int = 1, face: PerformerFace = FACE, **given: str
) -> TakeNeutral:
    return compare_neutral(
        face,
        positions,
        seen(positions),
        frames=np.arange(1, len(positions) + 1),
        stated_frame=stated,
        rate=60.0,
        **given,
    )


def nearest(positions: FloatArray, at: FloatArray) -> int:
    return 1 + int(((positions - at) ** 2).sum(axis=(1, 2)).argmin())


def test_a_take_of_the_same_markers_is_not_worth_a_word() -> None:
    other = performance(1)
    found = compare(other, stated=nearest(other, NEUTRAL))
    assert not found.is_reapplied
    assert found.notes("kitchen") == ()


def test_markers_put_on_again_are_said_and_the_worst_are_named() -> None:
    other = performance(1) + GLUE
    found = compare(other, stated=nearest(other, NEUTRAL + GLUE))
    (note,) = found.notes("kitchen")
    assert "the markers of kitchen were reapplied" in note
    worst = NAMES[int(np.linalg.norm(found.offset, axis=1).argmax())]
    assert f"{worst} " in note
    assert found.figures()["reapplied"] is True


def test_of_one_session_no_marker_was_put_on_again() -> None:
    other = performance(1) + GLUE
    assert not compare(other, session="monday").is_reapplied
    assert compare(other, session="tuesday").is_reapplied


def test_a_stated_frame_that_is_not_neutral_is_said_with_one_that_is() -> None:
    other = performance(1)
    smiling = 1 + int(((other - NEUTRAL) ** 2).sum(axis=(1, 2)).argmax())
    found = compare(other, stated=smiling)
    (note,) = found.notes("kitchen")
    assert f"neutral frame {smiling} is not neutral" in note
    assert f"--neutral {found.frame}" in note
    assert np.abs(other[found.frame - 1] - NEUTRAL).max() < 1.0
    assert found.neutral_frame == found.frame


@pytest.mark.parametrize("performer", ["Kim", ""])
def test_two_markers_with_each_others_label_are_named(performer: str) -> None:
    other = performance(1)
    far = int(np.linalg.norm(NEUTRAL - NEUTRAL[9], axis=1).argmax())
    other[:, [9, far]] = other[:, [far, 9]]
    named = " and ".join(NAMES[i] for i in sorted((9, far)))
    with pytest.raises(InputError, match=f"labels of {named} are exchanged throughout the take"):
        compare(other, performer=performer)


def test_a_mirrored_take_is_called_so() -> None:
    with pytest.raises(InputError, match=r"mirror image .*--mirrored axes"):
        compare(performance(1) * [-1.0, 1.0, 1.0])


def test_labels_of_two_lids_are_named_though_they_meet_in_blinks() -> None:
    """The offset is that of the frames that match: those in which the exchange is least."""
    near, far = 9, int(np.linalg.norm(NEUTRAL - NEUTRAL[9], axis=1).argmax())
    reference, other = performance(0), performance(1)
    for frames in (reference, other):
        frames[::4, near] = frames[::4, far]
    other[:, [near, far]] = other[:, [far, near]]
    with pytest.raises(InputError, match="are exchanged throughout the take"):
        compare(other, face=replace(FACE, frames=reference))


def test_another_skull_is_refused_unless_it_is_said_to_be_the_same() -> None:
    wide = performance(1) * [1.12, 1.0, 1.0]
    with pytest.raises(InputError, match=r"of another performer: its face is 1\d% larger"):
        compare(wide)
    (note, *_) = compare(wide, performer="Kim").notes("kitchen")
    assert note.startswith("kitchen may be of another performer than it states: its face is 1")
    with pytest.raises(InputError, match="of another performer"):
        compare(wide, performer="Lee")


def test_markers_put_on_carelessly_are_no_other_performer() -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        compare(performance(1) + rng.normal(size=NEUTRAL.shape) * 4.0 / np.sqrt(3))


def test_a_short_take_is_not_searched() -> None:
    short = performance(1, frames=300) + GLUE
    assert np.isnan(compare(short).reapplied_share)
    assert not replace(compare(short), reapplied_share=float("nan")).is_reapplied


def test_an_offset_is_as_large_as_that_of_the_markers_that_the_take_shows() -> None:
    other = performance(1) + GLUE
    shown = seen(other)
    shown[:, 10:] = False
    found = compare_neutral(
        FACE, other, shown, frames=np.arange(len(other)), stated_frame=0, rate=60.0
    )
    length = np.linalg.norm(found.offset, axis=1)
    assert not length[10:].any()
    assert found.offset_mm == pytest.approx(np.sqrt((length[:10] ** 2).mean()))


def test_a_flat_capture_is_compared_without_its_proportions() -> None:
    flat = np.array([1.0, 1.0, 0.0])
    face = replace(FACE, neutral=NEUTRAL * flat, frames=FRAMES * flat)
    other = performance(1) * flat
    assert compare(other, stated=nearest(other, NEUTRAL * flat), face=face).other_face == ""
