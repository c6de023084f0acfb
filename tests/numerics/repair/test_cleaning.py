"""The whole cleaning chain, on a simulated face with known damage and on recorded takes."""

import functools
import json
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.numerics.simulated_face import SimulatedFace, hold_head, simulate_face
from usdface.capture.sniff import read_capture
from usdface.numerics.repair import fit_low_rank
from usdface.numerics.repair.cleaning import CleanedMarkers, clean_markers
from usdface.numerics.repair.outliers import find_lost
from usdface.numerics.rigid.rigid_alignment import align_rigid
from usdface.numerics.rigid.rigid_markers import find_rigid_markers
from usdface.numerics.rigid.stabilization import stabilize


def clean(face: SimulatedFace, **options) -> CleanedMarkers:
    neutral = int(np.argmax(face.visible[:, list(face.rigid)].sum(axis=1)))
    return clean_markers(face.captured, face.visible, rigid=face.rigid, neutral=neutral, **options)


def errors_mm(cleaned: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distances after one rigid alignment of the whole take: the neutral poses differ."""
    a, b = truth.reshape(-1, 3), cleaned.reshape(-1, 3).astype(float)
    U, _, Vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    fitted = (truth - a.mean(0)) @ (U @ Vt) + b.mean(0)
    return np.linalg.norm(cleaned - fitted, axis=2)


def wrong_labels(swaps, found, shape) -> np.ndarray:
    """Samples that still carry another marker's label."""
    label = np.tile(np.arange(shape[1]), (shape[0], 1))
    for a, b, start, stop in (*sorted(swaps, key=lambda s: s[2]), *found):
        label[start:stop, [a, b]] = label[start:stop, [b, a]]
    return label != np.arange(shape[1])


@pytest.fixture(scope="module")
def damaged() -> tuple[SimulatedFace, CleanedMarkers]:
    face = simulate_face(
        frames=1200, noise=0.15, swapped_share=0.2, dropout_share=0.05, stray_count=30
    )
    return face, clean(face)


def test_swapped_labels_are_put_back_and_good_ones_left(damaged):
    face, cleaned = damaged
    found = [(s.first, s.second, s.start, s.stop) for s in cleaned.swaps]
    wrong = wrong_labels(face.swaps, found, face.visible.shape) & face.visible
    good = face.visible & ~face.swapped & ~face.strays
    assert face.swaps
    assert wrong[face.swapped].mean() < 0.05
    assert wrong[good].mean() < 0.001


def test_the_neutral_frame_says_which_labels_of_a_long_swap_are_right():
    """Swapped for almost half of the take, close together before it: their mean says nothing."""
    face = simulate_face(frames=1200, noise=0.15)
    closed = np.clip(np.minimum(np.arange(1200) - 15, 125 - np.arange(1200)) / 10, 0, 1)[:, None]
    upper, lower = 7, 73
    face.captured[:, upper] += 0.8 * closed * (face.captured[:, lower] - face.captured[:, upper])
    face.captured[500:1060, [upper, lower]] = face.captured[500:1060, [lower, upper]]
    cleaned = clean_markers(face.captured, face.visible, rigid=face.rigid, neutral=0)
    assert [(swap.start, swap.stop) for swap in cleaned.swaps] == [(500, 1060)]


@pytest.mark.parametrize("swapped", [slice(500, 1100), slice(0, 600)])
def test_a_label_that_jumps_to_a_lost_marker_is_put_back(swapped):
    face = simulate_face(frames=1500)
    away = np.linalg.norm(face.truth[0] - face.truth[0, 4], axis=1)
    other = int(away.argsort()[1])
    captured, visible = face.captured.copy(), face.visible.copy()
    captured[swapped, 4] = captured[swapped, other]
    visible[swapped, other] = False
    visible[swapped.start - 5 : swapped.start, 4] = False
    cleaned = clean_markers(captured, visible, rigid=face.rigid, neutral=1400, max_gap=0)
    found = [(swap.first, swap.second, swap.start, swap.stop) for swap in cleaned.swaps]
    assert found == [(*sorted((4, other)), swapped.start, swapped.stop)]


@pytest.mark.parametrize("hidden", [0, 10])
def test_swapped_labels_of_opposite_sides_are_put_back(hidden):
    face = simulate_face(frames=1500)
    away = np.linalg.norm(face.truth[0] - face.truth[0, 4], axis=1)
    other = int(away.argsort()[15])
    captured, visible = face.captured.copy(), face.visible.copy()
    captured[500:700, [4, other]] = captured[500:700, [other, 4]]
    visible[500 - hidden : 500, [4, other]] = visible[700 : 700 + hidden, [4, other]] = False
    cleaned = clean_markers(captured, visible, rigid=face.rigid, neutral=0)
    found = [(swap.first, swap.second, swap.start, swap.stop) for swap in cleaned.swaps]
    assert found == [(*sorted((4, other)), 500 - hidden, 700)]


def test_outliers_are_replaced_and_good_samples_are_not(damaged):
    face, cleaned = damaged
    good = face.visible & ~face.swapped & ~face.strays
    assert cleaned.outliers[face.strays].mean() > 0.9
    assert cleaned.outliers[good].mean() < 0.001


def test_mended_and_filled_samples_lie_where_the_skin_was(damaged):
    face, cleaned = damaged
    errors = errors_mm(cleaned.positions, face.truth)
    assert errors[face.swapped & cleaned.visible].mean() < 0.3
    assert errors[cleaned.filled].mean() < 0.3
    assert errors[face.visible].mean() < 0.2 < 0.26 == pytest.approx(0.15 * 3**0.5, abs=1e-3)


def test_head_motion_puts_clean_markers_back_where_they_were_captured(damaged):
    face, cleaned = damaged
    R, t = cleaned.head_motion[:, :3, :3], cleaned.head_motion[:, :3, 3]
    back = np.einsum("fij,fkj->fki", R, cleaned.positions) + t[:, None]
    untouched = face.visible & ~face.swapped & ~face.strays
    assert np.linalg.norm(back - face.captured, axis=2)[untouched].mean() < 0.3


def test_confidence_is_one_where_measured_and_lower_where_mended(damaged):
    face, cleaned = damaged
    relabelled = np.zeros_like(face.visible)
    for s in cleaned.swaps:
        relabelled[s.start : s.stop, [s.first, s.second]] = True
    measured = face.visible & ~cleaned.outliers & ~relabelled
    assert (cleaned.confidence[measured] == 1).all()
    assert cleaned.confidence[cleaned.filled].max() < 1
    assert (cleaned.confidence[~cleaned.visible] == 0).all()
    assert np.isfinite(cleaned.positions).all()


def drop(face: SimulatedFace, marker: int, *, start: int, mm: float, rate: float) -> None:
    """Let a marker fall at a frame and hang, swinging, at a distance below its place."""
    seconds = np.arange(1, len(face.captured) + 1 - start) / rate
    face.captured[start:, marker, 1] -= np.minimum(4905.0 * seconds**2, mm)
    swing = 0.1 * min(mm, 100.0) * np.sin(9.0 * seconds) * np.exp(-seconds)
    face.captured[start:, marker, 0] += swing


@functools.cache
def undamaged(rate: float) -> CleanedMarkers:
    """The five seconds of the next test before a marker falls; read only."""
    return clean(simulate_face(frames=round(5 * rate), rate=rate, noise=0.1), rate=rate)


@pytest.mark.parametrize("share", [0.6, 0.05])
@pytest.mark.parametrize(("mm", "rate"), [(1400.0, 30.0), (60.0, 30.0), (60.0, 120.0)])
def test_a_marker_that_falls_off_is_a_gap_from_its_first_step(share, mm, rate):
    face = simulate_face(frames=round(5 * rate), rate=rate, noise=0.1)
    still, marker = undamaged(rate), 20
    start = round(len(face.captured) * (1 - share))
    drop(face, marker, start=start, mm=mm, rate=rate)
    cleaned = clean(face, rate=rate)
    step = start + round(0.02 * rate)  # by more than noise
    assert cleaned.lost[step:, marker].all()
    assert not np.delete(cleaned.lost, marker, axis=1).any()
    assert (cleaned.confidence[step:, marker] < 1).all()
    others = np.linalg.norm(cleaned.positions - still.positions, axis=2)
    assert np.delete(others, marker, axis=1).max() < 0.1
    assert others[:, marker].max() < 5.0


def test_a_rigid_marker_that_falls_off_does_not_pull_the_head():
    face = simulate_face(frames=300, rate=60.0, noise=0.1)
    still, marker = clean(face, rate=60.0), face.rigid[0]
    drop(face, marker, start=150, mm=80.0, rate=60.0)
    cleaned = clean(face, rate=60.0)
    assert cleaned.lost[153:, marker].all()
    others = np.linalg.norm(cleaned.positions - still.positions, axis=2)
    assert np.delete(others, marker, axis=1).max() < 1.0  # 20 if it counts for the pose


def test_labels_swapped_up_to_the_end_are_no_markers_that_fell_off():
    face = simulate_face(frames=600, markers=24, noise=0.1)
    away = np.linalg.norm(face.truth[0] - face.truth[0, 20], axis=1)
    other = int(np.argmin(np.where(away > 60.0, away, np.inf)))
    swapped = face.truth.copy()
    swapped[300:, 20] = face.truth[300:, other]
    assert find_lost(swapped, face.visible, neutral=0)[300:, 20].all(), "so far from its place"
    swapped[300:, other] = face.truth[300:, 20]
    assert not find_lost(swapped, face.visible, neutral=0).any()


@pytest.mark.parametrize("name", ["crosstake", "onesided"])
def test_skin_of_recorded_motion_is_never_off_the_face(shared_data, name):
    """In pieces that end and start with any expression, of all markers or few of them."""
    take = read_capture(shared_data / name / "take.c3d").take
    about = json.loads((shared_data / name / "take.json").read_text())
    rigid = [take.markers.names.index(label) for label in about["rigid"]]
    positions, visible = take.markers.positions, take.markers.visible.copy()
    neutral = about["neutral_frame"]
    for first, second, start, stop in np.load(shared_data / name / "truth.npz")["swaps"]:
        visible[start:stop, [first, second]] = False
    head = stabilize(positions, visible, rigid=rigid, neutral=neutral)
    still = hold_head(positions, head)
    motion = np.linalg.norm(still - still[neutral], axis=2)
    assert np.quantile(motion[visible], 0.9999) > 30.0, "the jaw opens wide"
    rng = np.random.default_rng(0)
    for count in (102, 60, 30, 15) * 20:
        rows = rng.integers(len(still) - 120) + np.arange(rng.integers(60, 900))
        rows = rows[rows < len(still)]
        columns = rng.choice(102, count, replace=False)
        columns = columns[visible[rows][:, columns].any(axis=0)]
        at_rest = int(np.median(motion[rows], axis=1).argmin())
        piece = np.ix_(rows, columns)
        assert not find_lost(still[piece], visible[piece], neutral=at_rest).any()


def test_gaps_longer_than_allowed_are_left_and_predicted_from_the_other_markers():
    face = simulate_face(frames=600, noise=0.1)
    gap = np.s_[200:400, 20]
    face.visible[gap] = False
    cleaned = clean(face, max_gap=199)
    assert not cleaned.visible[gap].any()
    assert not cleaned.confidence[gap].any()
    away = errors_mm(cleaned.positions, face.truth)[gap]
    held = np.linalg.norm(face.truth[199, 20] - face.truth[gap], axis=1)
    assert away.mean() < 0.5 * held.mean()
    assert clean(face, max_gap=200).visible.all()


def test_a_clean_take_is_only_smoothed():
    face = simulate_face(frames=1200, noise=0.15)
    cleaned = clean(face)
    assert cleaned.swaps == ()
    assert cleaned.outliers.mean() < 1e-4
    assert cleaned.noise_mm == pytest.approx(0.15, rel=0.05)
    raw = clean(face, smooth=False, relabel=False)
    assert (
        errors_mm(cleaned.positions, face.truth).mean()
        < 0.8 * errors_mm(raw.positions, face.truth).mean()
    )


def test_peaks_of_blinks_are_kept():
    face = simulate_face(frames=1200, noise=0.15)
    cleaned = clean(face)
    size = np.linalg.norm(face.truth - np.median(face.truth, axis=0), axis=2)
    quick = np.abs(np.diff(size, 2, axis=0, prepend=0, append=0)).max(axis=0).argmax()
    peaks = size[:, quick] > np.quantile(size[:, quick], 0.99)
    offset = np.median(face.truth[:, quick], axis=0)
    found = cleaned.positions[:, quick] - np.median(cleaned.positions[:, quick], axis=0)
    assert np.linalg.norm(found[peaks], axis=1).mean() == pytest.approx(
        np.linalg.norm(face.truth[peaks, quick] - offset, axis=1).mean(), rel=0.03
    )


@pytest.mark.parametrize(("rate", "lost"), [(24, 0), (30, 0), (60, 0), (60, 3)])
def test_a_wink_that_no_other_marker_predicts_is_kept(rate, lost):
    face = simulate_face(frames=1200, noise=0.15)
    lid, seconds = 20, np.arange(0, 0.25, 1 / rate)  # shut in 80 ms
    closing = 8 * np.sin(np.pi / 2 * np.interp(seconds, [0, 0.08, 0.25], [0, 1, 2])) ** 2
    frames, shut = len(seconds), int(np.argmax(closing))
    down = np.array([0.0, -1.0, 0.0])
    face.truth[600 : 600 + frames, lid] += closing[:, None] * down
    turn = np.linalg.svd(  # the head's in the middle of it
        (face.truth[602] - face.truth[602].mean(0)).T
        @ (face.captured[602] - face.captured[602].mean(0))
    )
    face.captured[600 : 600 + frames, lid] += closing[:, None] * (down @ turn[0] @ turn[2])
    face.visible[600 + shut : 600 + shut + lost, lid] = False  # covered by the brow
    cleaned = clean(face, rate=rate)
    assert not cleaned.outliers[:, lid].any()
    kept = np.setdiff1d(np.arange(600, 600 + frames), 600 + shut + np.arange(lost))
    assert errors_mm(cleaned.positions, face.truth)[kept, lid].max() < 2.5


@pytest.mark.parametrize("rate", [24, 30])
def test_strays_are_found_at_low_rates(rate):
    face = simulate_face(frames=1200, rate=rate, noise=0.15, stray_count=30)
    cleaned = clean(face, rate=rate)
    assert cleaned.outliers[face.strays].mean() > 0.9
    assert cleaned.outliers[face.visible & ~face.strays].mean() < 0.001


def test_frames_with_nothing_seen_are_bridged():
    face = simulate_face(frames=800, noise=0.05)
    face.visible[400:406] = False
    cleaned = clean(face)
    assert cleaned.visible.all()
    assert (cleaned.pose_confidence[400:406] < 1).all()
    assert errors_mm(cleaned.positions, face.truth)[400:406].mean() < 1.5


def test_the_face_tells_the_pose_where_too_few_rigid_markers_are_seen():
    face = simulate_face(frames=1200, noise=0.1)
    hidden = np.zeros(1200, bool)
    for start, length in ((100, 3), (300, 30), (600, 90)):
        hidden[start : start + length] = True
    face.visible[np.ix_(hidden, list(face.rigid)[2:])] = False
    cleaned = clean(face)
    away = errors_mm(cleaned.positions, face.truth)
    head = stabilize(face.captured, face.visible, rigid=face.rigid, neutral=0)
    interpolated = hold_head(face.captured, head)
    assert away[hidden].mean() < 1.3 * away[~hidden].mean()
    assert errors_mm(interpolated, face.truth)[hidden].mean() > 3.0
    confidence = cleaned.pose_confidence
    assert (confidence[~hidden] == 1).all()
    assert ((0.9 < confidence[hidden]) & (confidence[hidden] < 1)).all()


def test_a_head_that_turns_after_its_rigid_markers_are_covered_has_lost_no_marker():
    face = simulate_face(frames=600, noise=0.1)
    angle = np.linspace(0.0, np.radians(80), 120)
    turn = Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    centre = face.captured[480:].mean(axis=1, keepdims=True)
    face.captured[480:] = (face.captured[480:] - centre) @ turn.swapaxes(1, 2) + centre
    face.visible[480:, list(face.rigid)[2:]] = False
    cleaned = clean(face)
    assert not cleaned.lost.any()
    assert not cleaned.swaps
    away = errors_mm(cleaned.positions, face.truth)
    assert away[480:].mean() < 0.5  # 30 with all of them lost


def test_a_pose_by_an_unknown_expression_is_known_to_be_uncertain():
    """Half of the face moves as never before where no rigid marker is seen."""
    face = simulate_face(frames=600, noise=0.1)
    poses = align_rigid(face.captured, face.truth, weights=np.ones(face.visible.shape))
    lower = np.argsort(face.truth[0, :, 1])[: face.visible.shape[1] // 2]
    opening = np.zeros(600)
    opening[350:] = 12.0 * np.sin(np.arange(250) / 20.0) ** 2
    down = poses.rotations @ [0.0, -1.0, 0.3]
    face.captured[:, lower] += (opening[:, None] * down)[:, None].astype(np.float32)
    face.visible[300:, list(face.rigid)] = False
    confidence = clean(face, relabel=False).pose_confidence
    assert np.median(confidence[opening > 6]) < 0.5 < 0.9 < np.median(confidence[300:350])


def test_a_take_seen_in_one_frame_alone_is_cleaned_without_a_warning():
    face = simulate_face(frames=60, noise=0.05)
    face.visible[:] = False
    face.visible[5] = True
    cleaned = clean(face)
    assert np.isfinite(cleaned.positions).all()
    np.testing.assert_allclose(cleaned.positions[5], face.captured[5], atol=0.1)


def test_a_marker_seen_in_one_frame_of_a_long_take_is_cleaned(monkeypatch):
    monkeypatch.setattr(fit_low_rank, "_FIT_FRAMES", 100)  # 16,000 of longer takes
    face = simulate_face(frames=900)
    face.visible[:, 7] = np.arange(900) == 450
    cleaned = clean(face)
    assert errors_mm(cleaned.positions, face.truth)[450, 7] < 1.0


def test_two_rigid_markers_are_refused():
    face = simulate_face(frames=300)
    with pytest.raises(ValueError, match="name more rigid markers"):
        clean_markers(face.captured, face.visible, rigid=(0, 1), neutral=0)


@pytest.mark.slow
def test_the_shared_take_is_mended_within_the_targets(shared_data):
    from usdface.capture.sniff import read_capture

    meta = json.loads((shared_data / "crosstake/take.json").read_text())
    truth = np.load(shared_data / "crosstake/truth.npz")
    markers = read_capture(shared_data / "crosstake/take.c3d").take.markers
    started = time.process_time()
    cleaned = clean_markers(
        markers.positions,
        markers.visible,
        rigid=[markers.names.index(name) for name in meta["rigid"]],
        neutral=meta["neutral_frame"],
    )
    seconds = time.process_time() - started
    swaps = [tuple(int(n) for n in swap) for swap in truth["swaps"]]
    found = [(s.first, s.second, s.start, s.stop) for s in cleaned.swaps]
    swapped = np.zeros(markers.visible.shape, bool)
    for a, b, start, stop in swaps:
        swapped[start:stop, [a, b]] = True
    wrong = wrong_labels(swaps, found, swapped.shape)
    errors = errors_mm(cleaned.positions[::10][: len(truth["clean"])], truth["clean"].astype(float))
    mended, filled = (m[::10][: len(errors)] for m in (swapped, cleaned.filled))
    assert wrong[swapped].mean() < 0.05
    assert (wrong[~swapped] | cleaned.outliers[~swapped]).mean() < 0.001
    assert errors[mended].mean() < 0.3
    assert errors[filled].mean() < 0.3
    assert seconds < 60  # 14 on an idle core


@pytest.mark.parametrize("name", ["CheeksMoCap", "EyebrowsMoCap"])
def test_recorded_takes_without_a_rigid_set_survive_damage(shared_data, name):
    from usdface.capture.sniff import read_capture

    markers = read_capture(shared_data / f"markers_animface/{name}.c3d").take.markers
    rigid = find_rigid_markers(markers.positions, markers.visible).indices
    whole = clean_markers(markers.positions, markers.visible, rigid=rigid, neutral=0)
    rng = np.random.default_rng(0)
    positions, visible = markers.positions.copy(), markers.visible.copy()
    for _ in range(12):
        start, marker = int(rng.integers(10, len(positions) - 60)), int(rng.integers(41))
        visible[start : start + 40, marker] = False
    positions[300:360, [4, 6]] = positions[300:360, [6, 4]]
    cleaned = clean_markers(positions, visible, rigid=rigid, neutral=0)
    assert whole.outliers.mean() < 0.001
    assert [(s.first, s.second, s.start, s.stop) for s in cleaned.swaps] == [(4, 6, 300, 360)]
    offsets = np.linalg.norm(cleaned.positions - whole.positions, axis=2)
    assert offsets[~visible].mean() < 1.5  # of skin that moves by 20 to 40
    assert offsets[visible].mean() < 0.2
