"""Edits on a solve: the last change wins, fades blend, the solve beneath may change."""

import numpy as np
import pytest

from usdface.numerics.motion.key_reduction import (
    EditCurve,
    add_to_edit,
    apply_edit,
    clear_edit,
    fade_mask,
    needed_samples,
    no_edit,
    override_edit,
)

FRAMES = np.arange(100, 160)
RNG = np.random.default_rng(0)


def test_folding_changes_equals_making_them_one_after_the_other() -> None:
    solved = RNG.random(len(FRAMES))
    edit, shown = no_edit(len(FRAMES)), solved.copy()
    for _ in range(40):
        first = int(RNG.integers(100, 150))
        mask = fade_mask(FRAMES, first, first + int(RNG.integers(0, 12)), fade=int(RNG.integers(9)))
        value = float(RNG.normal(0, 0.4))
        kind = RNG.integers(3)
        if kind == 0:
            edit, shown = add_to_edit(edit, value, mask), shown + mask * value
        elif kind == 1:
            edit, shown = override_edit(edit, value, mask), (1 - mask) * shown + mask * value
        else:
            edit, shown = clear_edit(edit, mask), (1 - mask) * shown + mask * solved
        np.testing.assert_allclose(apply_edit(solved, edit), shown, atol=1e-12)
    assert edit.mask.min() >= 0
    assert edit.mask.max() <= 1


def test_an_offset_moves_with_the_solve_and_an_override_does_not() -> None:
    everywhere = np.ones(len(FRAMES))
    solved = RNG.random(len(FRAMES))
    nothing = no_edit(len(FRAMES))
    added, held = add_to_edit(nothing, 0.1, everywhere), override_edit(nothing, 0.7, everywhere)
    for beneath in (solved, solved + 0.2):
        np.testing.assert_allclose(apply_edit(beneath, added), beneath + 0.1)
        np.testing.assert_allclose(apply_edit(beneath, held), 0.7)


def test_a_fade_eases_and_is_symmetric() -> None:
    mask = fade_mask(FRAMES, 120, 130, fade=9)
    inside = (FRAMES >= 120) & (FRAMES <= 130)
    assert (mask[inside] == 1).all()
    np.testing.assert_allclose(mask[FRAMES == 115], 0.5)  # half way of ten frames from 1 to 0
    assert mask[FRAMES == 110] == pytest.approx(0)
    around = mask[(FRAMES >= 110) & (FRAMES <= 140)]
    np.testing.assert_allclose(around, around[::-1])
    assert (fade_mask(FRAMES, 120, 130) == inside).all()


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(ValueError, match="no range"):
        fade_mask(FRAMES, 5, 4)


def test_clearing_everything_leaves_nothing_active() -> None:
    edit = EditCurve(RNG.random(60), RNG.random(60), RNG.random(60))
    assert not clear_edit(edit, np.ones(60)).active.any()


def test_samples_left_out_are_found_again_by_linear_interpolation() -> None:
    values = np.repeat(RNG.integers(0, 3, 30).astype(float), RNG.integers(1, 6, 30))
    frames = np.arange(len(values))
    needed = needed_samples(values)
    np.testing.assert_array_equal(np.interp(frames, frames[needed], values[needed]), values)
    assert needed.sum() < len(values)
    assert needed_samples(np.full(9, 0.3)).sum() == 1
