"""Takes of one performer, from files to one head space and one neutral face."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.numerics.registration.test_marker_application import GLUE, NEUTRAL, performance
from usdface.core.arrays import FloatArray
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.model.mapping.performer_face import PerformerFace
from usdface.steps.inputs.cleaned_takes import read_cleaned_takes, take_head_space
from usdface.steps.inputs.placement import read_performer_markers
from usdface.usdio.take.read import TakeReader, read_take
from usdface.usdio.take.write import write_take

NAMES = tuple(f"m{i:02d}" for i in range(len(NEUTRAL)))


def write(
    folder: Path,
    name: str,
    positions: FloatArray,
    *,
    names: tuple[str, ...] = NAMES,
    rigid: tuple[str, ...] = NAMES[:8],
    rate: int = 60,
    hidden: tuple[slice, int] | None = None,
    **stated: str,
) -> Path:
    seen = np.ones(positions.shape[:2], bool)
    if hidden is not None:
        seen[hidden] = False
    neutral = int(((positions - positions[0]) ** 2).sum(axis=(1, 2)).argmin())
    markers = Markers(
        names=names,
        positions=positions.astype(np.float32),
        visible=seen,
        confidence=seen.astype(np.float32),
        rigid=rigid,
        neutral_frame=1 + neutral,
        space="stabilized",
    )
    path = folder / f"{name}.take.usda"
    write_take(
        path, Take(name, Fraction(rate), 1, markers=markers, **stated), provenance=Provenance()
    )
    return path


def from_neutral(seed: int) -> FloatArray:
    """A performance that begins with the neutral face."""
    return np.concatenate([NEUTRAL[None], performance(seed)])


@pytest.mark.parametrize(("share", "left_out"), [(0.4, ()), (0.6, (NAMES[-1],))])
def test_a_marker_that_is_lost_for_most_of_the_takes_is_left_out(
    tmp_path: Path, share: float, left_out: tuple[str, ...]
) -> None:
    positions = from_neutral(0)
    last = len(NAMES) - 1
    lost = slice(len(positions) - round(share * len(positions)), None)
    take = write(tmp_path, "first", positions, hidden=(lost, last))
    assert read_cleaned_takes((take,)).dropped == left_out
    whole = write(tmp_path, "second", from_neutral(0))
    assert read_cleaned_takes((take, whole)).dropped == ()


def test_a_rigid_marker_that_is_not_in_the_take_is_left_out(tmp_path: Path) -> None:
    take = write(tmp_path, "first", from_neutral(0), rigid=("nose", *NAMES[:8]))
    assert read_cleaned_takes((take,)).rigid == NAMES[:8]
    assert read_performer_markers(TakeReader(take), [1]).rigid == tuple(range(8))


def test_a_take_of_another_day_meets_the_first(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.05, -0.1, 0.02]).as_matrix()
    first = write(tmp_path, "first", from_neutral(0))
    second = write(tmp_path, "second", (from_neutral(1) + GLUE) @ turn.T + [5.0, 9.0, -3.0])
    takes = read_cleaned_takes((first, second))
    away = takes.positions[1] - from_neutral(1)
    assert np.sqrt((away**2).sum(axis=2).mean()) < np.sqrt((GLUE**2).sum(axis=1).mean()) / 3
    np.testing.assert_allclose(takes.positions[0], from_neutral(0), atol=1e-4)
    assert not takes.neutrals[0].offset.any()
    assert takes.neutrals[1].is_reapplied


def test_takes_are_compared_with_a_mapping_by_their_length_in_seconds(tmp_path: Path) -> None:
    """Distances are compared in takes of ten seconds and more, whatever their rate."""
    frames = from_neutral(0)
    seen = np.ones(frames.shape[:2], bool)
    face = PerformerFace(NAMES, NAMES[:8], NEUTRAL, frames, seen, "Kim", "")
    count = len(frames)
    for rate, compared in ((count // 15, True), (count // 6, False)):
        moved = from_neutral(1) + GLUE
        path = write(tmp_path, f"at{rate}", moved, rate=rate, performer="Kim")
        space = read_cleaned_takes((path,)).head_space(face)
        assert np.isfinite(space.neutral.reapplied_share) == compared


def test_the_session_is_kept_and_used(tmp_path: Path) -> None:
    first = write(tmp_path, "first", from_neutral(0), session="monday", performer="Kim")
    assert read_take(first).session == "monday"
    second = write(tmp_path, "second", from_neutral(1) + GLUE, session="monday")
    assert not read_cleaned_takes((first, second)).neutrals[1].is_reapplied


def test_takes_with_other_detected_rigid_markers_meet_by_the_most_frequent(tmp_path: Path) -> None:
    sets = [(0, 1, 2, 3), (0, 1, 4, 5), (1, 2, 3, 6)]
    paths = tuple(
        write(tmp_path, f"take{k}", from_neutral(k), rigid=tuple(NAMES[i] for i in chosen))
        for k, chosen in enumerate(sets)
    )
    assert read_cleaned_takes(paths).rigid == tuple(NAMES[i] for i in (0, 1, 2, 3))
    with pytest.raises(InputError, match="2 common rigid markers, at least 3 are needed"):
        read_cleaned_takes(
            tuple(write(tmp_path, n, from_neutral(0), rigid=NAMES[:2]) for n in "ab")
        )


def test_takes_of_two_performers_are_refused(tmp_path: Path) -> None:
    first = write(tmp_path, "first", from_neutral(0), performer="Kim")
    second = write(tmp_path, "second", from_neutral(1), performer="Lee")
    with pytest.raises(InputError, match=r"takes of 2 performers .*first.*Kim.*second.*Lee"):
        read_cleaned_takes((first, second))
    wide = write(tmp_path, "wide", from_neutral(1) * [1.12, 1.0, 1.0])
    with pytest.raises(InputError, match=r"wide.take.usda, with .*of another performer"):
        read_cleaned_takes((first, wide))


def test_markers_and_landmarks_of_one_performer_are_no_second_performer(tmp_path: Path) -> None:
    first = write(tmp_path, "first", from_neutral(0), performer="Kim")
    landmarks = tuple(f"landmark_{i}" for i in range(len(NAMES)))
    video = write(tmp_path, "video", from_neutral(1), names=landmarks, performer="Kim")
    with pytest.raises(InputError, match="several marker sets, of 40, 40 markers with 0 labels"):
        read_cleaned_takes((first, video))


def test_takes_in_two_units_are_refused_with_the_option_that_mends_it(tmp_path: Path) -> None:
    first = write(tmp_path, "first", from_neutral(0))
    second = write(tmp_path, "second", from_neutral(1) / 10)
    message = r"0.1 times those of .* another unit; ingest the take again .*--units cm"
    with pytest.raises(InputError, match=message):
        read_cleaned_takes((first, second))
    message = r"10 times those of .* another unit; ingest those again .*--units cm"
    with pytest.raises(InputError, match=message):
        read_cleaned_takes((second, first))


def test_takes_are_aligned_by_the_pairs_and_the_neutral_frame_of_the_first(tmp_path: Path) -> None:
    """As each alone, though their frames are rows of all of them."""
    positions = from_neutral(0)
    first = write(tmp_path, "first", positions + GLUE)
    takes = read_cleaned_takes((first, write(tmp_path, "second", from_neutral(1) + GLUE)))
    frames = np.arange(40, len(positions), 150)
    sample = performance(2)
    face = PerformerFace(
        NAMES,
        NAMES[:8],
        NEUTRAL,
        sample,
        np.ones(sample.shape[:2], bool),
        pairs={"first": (frames, positions[frames - 1])},
    )
    together, alone = takes.head_space(face), take_head_space(TakeReader(first), face)
    assert np.ndim(together.pair_offset)
    np.testing.assert_allclose(together.pair_offset, alone.pair_offset, atol=1e-3)
    assert together.neutral.stated_frame == alone.neutral.stated_frame == 1
    assert takes.neutrals[0].neutral_frame == 1
