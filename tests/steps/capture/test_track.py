"""A video becomes a take: frames by their times, heads in space, gaps where no face is."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Vt
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

import usdface.steps.capture.track_pictures as step
from tests.capture.simulated_faces import SCORES, SimulatedFinder, head_points, turning_head
from tests.media.bar_code import HEIGHT, WIDTH, write_numbered
from tests.media.film.stated_movie import write_stated_movie
from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.errors import InputError
from usdface.core.sidecars import work_folder
from usdface.media.picture.image import write_image
from usdface.numerics.rigid.rigid_alignment import align_rigid
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, TrackSpec
from usdface.steps.capture.track_notes import eye_columns
from usdface.usdio.take.read import read_take

FOCAL = 28.0
FOCAL_PIXELS = FOCAL / np.hypot(36, 24) * np.hypot(WIDTH, HEIGHT)


@pytest.fixture
def tracked(tmp_path: Path, monkeypatch):
    """Track a clip with a simulated model; the picture's number says what it shows."""
    monkeypatch.setattr(step, "check_model", lambda path: "0" * 64)
    model = tmp_path / "face_landmarker.task"
    model.write_bytes(b"")

    def run(video: Path, faces, *, looks: int = 1, first: int = 0, **options):
        finder = SimulatedFinder(faces, focal_pixels=FOCAL_PIXELS, looks=looks, first=first)
        monkeypatch.setattr(step, "FaceLandmarker", lambda path: finder)
        asked = {"model": model, "quality": "draft", "out": tmp_path / "x.take.usda"}
        if not {"part", "calibration"} & options.keys():
            asked["focal_length"] = FOCAL
        asked |= options
        result = execute(TrackSpec(video=video, **asked), overwrite=True)
        return result, None if "part" in options else read_take(asked["out"])

    return run


def one_head(number: int):
    return [turning_head(number)]


def clip(path: Path, count: int = 24, rate: int = 24, *, timecode: str = "") -> Path:
    pictures = [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * count
    write_stated_movie(path, pictures, rate=Fraction(rate), timecode=timecode)
    return path


def test_a_head_is_where_it_was_and_cleaning_takes_its_motion_out(tracked, tmp_path) -> None:
    result, take = tracked(clip(tmp_path / "a.mp4", 40), one_head, performer="Kim")
    assert (take.rate, take.first_frame, take.frame_count) == (24, 1, 40)
    assert (take.video.file, take.video.offset) == (tmp_path / "a.mp4", 0)
    assert (take.performer, take.name, take.markers.names) == ("Kim", "a", LANDMARKS.names)
    points = np.stack([turning_head(n) for n in range(40)])[:, LANDMARKS.indices]
    right, left = eye_columns()
    size = np.linalg.norm(points[0, left].mean(axis=0) - points[0, right].mean(axis=0)) / 63.0
    rest = head_points()[LANDMARKS.indices] / size
    pose = align_rigid(take.markers.positions, rest)
    placed = rest @ pose.rotations.transpose(0, 2, 1) + pose.translations[:, None]
    assert np.abs(take.markers.positions - placed).max() < 0.01
    truth = align_rigid(points, head_points()[LANDMARKS.indices])
    np.testing.assert_allclose(pose.rotations, truth.rotations, atol=1e-4)
    # the least of the scores that are no gaze is at the first picture
    assert take.markers.neutral_frame == 1
    assert take.source.names == SCORES
    assert take.source.values[20, 2] == pytest.approx(0.7)
    clean = tmp_path / "x.clean.take.usda"
    execute(CleanSpec(take=tmp_path / "x.take.usda", out=clean, relabel=False, smooth=False))
    still = read_take(clean)
    assert np.ptp(still.markers.positions, axis=0).max() < 0.1
    assert still.head_motion is not None
    np.testing.assert_array_equal(still.markers.confidence, take.markers.confidence)
    assert result.figures["face_share"] == 1.0


def test_a_lens_that_distorts_is_undone(tracked, tmp_path, monkeypatch) -> None:
    """Barrel distortion: what is seen at d of the focal length lies at r, with r + k r³ = d."""
    video, k = clip(tmp_path / "a.mp4", 6), -0.2
    _, straight = tracked(video, one_head)
    find = SimulatedFinder.find_faces

    def bent(self, picture):
        faces = find(self, picture)
        for face in faces:
            place = (face.landmarks[:, :2] - (WIDTH / 2, HEIGHT / 2)) / FOCAL_PIXELS
            factor = 1 + k * (place**2).sum(axis=1, keepdims=True)
            face.landmarks[:, :2] = place * factor * FOCAL_PIXELS + (WIDTH / 2, HEIGHT / 2)
        return faces

    monkeypatch.setattr(SimulatedFinder, "find_faces", bent)
    _, wrong = tracked(video, one_head)
    _, right = tracked(video, one_head, distortion=(k, 0.0))
    off = [np.abs(each.markers.positions - straight.markers.positions) for each in (wrong, right)]
    assert off[0].max() > 0.5
    assert off[1].max() < 0.01
    with pytest.raises(InputError, match=r"-9,0 with a focal length of \d+ pixels cannot be"):
        tracked(video, one_head, distortion=(-9.0, 0.0))
    with pytest.raises(ValidationError, match=r"3 numbers are given; OpenCV's model has k1,k2"):
        tracked(video, one_head, distortion=(0.1, 0.0, 0.1))


def test_uneven_pictures_lie_at_their_times(tracked, tmp_path) -> None:
    stamps = [0, 33, 67, 100, 167, 200, 240, 267, 300, 500, 533, 567]  # a phone: a jump, a hole
    video = tmp_path / "phone.mp4"
    write_numbered(video, stamps, base=Fraction(1, 1000), rate=Fraction(30))

    def nodding(number: int):
        return [turning_head(0) + np.array([0.05 * stamps[number], 0, 0])]

    result, take = tracked(video, nodding)
    assert (take.rate, take.frame_count) == (30, 18)
    assert any("the video's rate varies" in note for note in result.notes)
    assert any(note.startswith("no pictures in frames 11-15") for note in result.notes)
    seen = take.markers.visible.any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(~seen), np.arange(10, 15))
    nose = take.markers.positions[:, take.markers.names.index("nose_tip_1")]
    moved = (nose[:, 0] - nose[0, 0])[seen]
    # 50 mm a second of the simulated head, and its scale
    expected = np.arange(18)[seen] / 30 * 50 * np.ptp(moved) / (0.05 * 567)
    np.testing.assert_allclose(moved, expected, atol=0.15)


def test_timecode_follows_the_frames_and_a_wrong_one_is_named(
    tracked, tmp_path, monkeypatch
) -> None:
    video = clip(tmp_path / "a.mov", 12, timecode="01:00:00:20")
    assert tracked(video, one_head)[1].timecode_start == "01:00:00:20"
    assert tracked(video, one_head, frames="6-12")[1].timecode_start == "01:00:01:01"
    monkeypatch.setattr("usdface.media.film.video._timecode", lambda container: "01:00:00:99")
    result, take = tracked(video, one_head)
    assert take.timecode_start == ""
    assert any("01:00:00:99" in note for note in result.notes)


def test_frames_without_a_face_are_gaps_and_frames_are_chosen(tracked, tmp_path) -> None:
    video = clip(tmp_path / "b.mp4", 30)
    result, take = tracked(video, lambda n: [] if 5 <= n < 9 else one_head(n), frames="11-30")
    assert (take.first_frame, take.frame_count) == (11, 20)
    assert take.video.video_time(0.0) == pytest.approx(10 / 24)
    assert (np.flatnonzero(~take.markers.visible.all(axis=1)) == np.arange(5, 9)).all()
    assert (take.markers.confidence[5:9] == 0).all()
    assert take.source.gaps == ((16, 19),)
    assert any(
        "no face, or not the tracked one, in 4 pictures of 20, frames 16-19" in note
        for note in result.notes
    )
    with pytest.raises(InputError, match="no face is visible at the neutral frame 7; name another"):
        tracked(video, lambda n: [] if 5 <= n < 9 else one_head(n), neutral=7)
    result, _ = tracked(video, lambda n: [] if n < 20 else one_head(n))
    assert any("is upside down" in note for note in result.notes)
    slow = clip(tmp_path / "slow.mp4", 12, rate=10)
    result, _ = tracked(slow, one_head)
    assert any("10 pictures per second: blinks" in note for note in result.notes)
    assert not any("--rate" in note for note in result.notes)
    with pytest.raises(InputError, match=r"--frames 90-99 is outside its frames, 1 to 30"):
        tracked(video, one_head, frames="90-99")
    with pytest.raises(InputError, match=r"--neutral 5 is outside the frames to track, 11 to 30"):
        tracked(video, one_head, frames="11-30", neutral=5)
    with pytest.raises(InputError, match=r"no face in any of 30 pictures; .*ffmpeg"):
        tracked(video, lambda n: [])


def test_a_lying_video_and_a_cut_are_said(tracked, tmp_path) -> None:
    video = clip(tmp_path / "c.mp4", 12)
    lying = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for turn, remedy in ((lying, -90), (lying.T, 90)):
        message = rf"rotated by -?90 degrees in the picture; .* -display_rotation {remedy} "
        with pytest.raises(InputError, match=message):
            tracked(video, lambda n, turn=turn: [turning_head(n) @ turn.T])
    result, _ = tracked(video, lambda n: [np.add(turning_head(n), [0 if n < 6 else 250, 0, 0])])
    assert any("the face jumps at frame 7; if these are cuts" in note for note in result.notes)
    nearer, other = np.array([0, 0, 130.0]), np.array([1.0, 1.4, 1.0])
    for changed in (lambda face: face + nearer, lambda face: face * other):
        result, _ = tracked(
            video,
            lambda n, changed=changed: [turning_head(n) if n < 6 else changed(turning_head(n))],
        )
        assert any("the face jumps at frame 7; if these are cuts" in note for note in result.notes)
    result, _ = tracked(video, one_head)
    assert not any("jumps" in note for note in result.notes)


def test_a_face_that_is_covered_throughout_is_guessed_and_not_trusted(tracked, tmp_path) -> None:
    rng = np.random.default_rng(3)

    def covered(number: int):
        return [turning_head(number) + rng.normal(size=(478, 3)) * (5, 5, 0)]

    video = clip(tmp_path / "e.mp4", 12)
    result, take = tracked(video, covered, quality="final", looks=2)
    assert any("of its mirror image differ by" in note for note in result.notes)
    assert np.median(take.markers.confidence) < 0.9
    result, take = tracked(video, one_head, quality="final", looks=2)
    assert not any("mirror image" in note for note in result.notes)
    assert (take.markers.confidence[take.markers.visible] == 1).all()


def test_frames_with_something_before_the_face_are_named(tracked, tmp_path) -> None:
    rng = np.random.default_rng(3)
    hidden = {5, *range(20, 27), *range(30, 36)}  # one picture is blurred, not covered

    def covered(number: int):
        noise = np.where(np.arange(478)[:, None] < (120 if number in hidden else 0), 5.0, 0.3)
        return [turning_head(number) + rng.normal(size=(478, 3)) * noise * (1, 1, 0)]

    video = clip(tmp_path / "e.mp4", 48)
    result, _ = tracked(video, covered, quality="final", looks=2)
    (note,) = (each for each in result.notes if "partly covered" in each)
    assert note.startswith("frames 21-36: the face is partly covered")
    hidden &= {5}
    for quality, looks in (("final", 2), ("draft", 1)):
        result, _ = tracked(video, covered, quality=quality, looks=looks)
        assert not any("partly covered" in note for note in result.notes)


@pytest.mark.parametrize(("quality", "looks"), [("final", 2), ("draft", 1)])
def test_landmarks_beyond_the_edge_of_the_picture_are_gaps(
    tracked, tmp_path, quality, looks
) -> None:
    """The model guesses them: 6 % of the face's breadth wrong in a recording, twenty times more."""

    def sinking(number: int):
        return [np.add(turning_head(number), [0, -150 if number < 20 else 0, 0])]

    video = clip(tmp_path / "e.mp4", 48)
    result, take = tracked(video, sinking, quality=quality, looks=looks)
    (note,) = (each for each in result.notes if "the picture's edge" in each)
    assert note.startswith("frames 1-20: the picture's edge cuts off up to ")
    chin = take.markers.names.index("chin_1")
    np.testing.assert_array_equal(np.flatnonzero(~take.markers.visible[:, chin]), np.arange(20))
    assert (take.markers.confidence[:20, chin] == 0).all()
    assert take.markers.neutral_frame == 21  # the least expression is in frame 1
    assert take.markers.visible[:, take.markers.names.index("forehead_1")].all()


def test_of_a_profile_the_hidden_side_is_a_gap(tracked, tmp_path) -> None:
    turn = Rotation.from_euler("y", -60, degrees=True).as_matrix()
    faces = head_points() @ turn.T + (0, 0, -600)
    _, take = tracked(
        clip(tmp_path / "d.mp4", 8), lambda n: one_head(n) if n < 4 else [faces], neutral=1
    )
    names = take.markers.names
    assert take.markers.visible[:4].all()
    hidden = {name for name, seen in zip(names, take.markers.visible[7], strict=True) if not seen}
    assert "temple_R1" not in hidden or "temple_L1" not in hidden
    assert hidden & {"temple_R1", "temple_L1"}
    assert not hidden & {"nose_tip_1", "lip_upper_1", "chin_1"}


PAIR = """[front]
matrix = [[{focal}, 0, {x}], [0, {focal}, {y}], [0, 0, 1]]
size = [{width}, {height}]
rotation = [0, 0, 0]
translation = [0, 0, 0]

[side]
matrix = [[{focal}, 0, {x}], [0, {focal}, {y}], [0, 0, 1]]
rotation = [0, {turn}, 0]
translation = [{shift[0]}, 0, {shift[2]}]
"""
TURN = Rotation.from_euler("y", 30, degrees=True)
"""Of the side camera about the middle of where heads are, as OpenCV's axes go."""
MIDDLE = np.array([0, 0, 600.0])


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    path = tmp_path / "camera_array.toml"
    numbers = {"focal": FOCAL_PIXELS, "x": WIDTH / 2, "y": HEIGHT / 2, "turn": np.radians(30)}
    shift = (MIDDLE - TURN.apply(MIDDLE)).tolist()
    path.write_text(PAIR.format(**numbers, width=WIDTH, height=HEIGHT, shift=shift))
    return path


def from_the_side(points: np.ndarray) -> np.ndarray:
    """The head in the side camera's space, Y up."""
    flip = np.array([1.0, -1.0, -1.0])
    return (TURN.apply(points * flip - MIDDLE) + MIDDLE) * flip


def by_two(count: int):
    """A face that nods, which the model of one picture makes flat; the second video's follow."""

    def faces(number: int):
        if number < count:
            return one_head(number)
        return [from_the_side(turning_head(number - count))]

    return faces


def test_two_cameras_are_joined(tracked, pair, tmp_path) -> None:
    front, side = clip(tmp_path / "front.mp4", 24), clip(tmp_path / "side.mp4", 24)
    _, one = tracked(front, one_head, calibration=pair, cameras=("front",))
    result, take = tracked(front, by_two(24), views=(side,), calibration=pair)
    assert take.video.file == front
    assert result.figures["cameras"] == 2
    assert any("front.mp4 by front, side.mp4 by side" in note for note in result.notes)
    np.testing.assert_allclose(take.markers.positions, one.markers.positions, atol=0.05)
    # what a hand hides from one camera is seen by the other
    rng = np.random.default_rng(1)
    mouth = LANDMARKS.indices[LANDMARKS.columns("lip_upper", "lip_lower")]

    def hidden(number: int, look=[0]):  # noqa: B006  # counts looks
        (points,) = by_two(24)(number)
        look[0] += 1
        if 8 <= number < 16 and look[0] % 2:
            points = points.copy()
            points[mouth, :2] += rng.normal(size=(len(mouth), 2)) * 20
        return [points]

    _, other = tracked(front, hidden, looks=2, quality="final", views=(side,), calibration=pair)
    lips = LANDMARKS.columns("lip_upper", "lip_lower")
    off = np.linalg.norm((other.markers.positions - take.markers.positions)[8:16, lips], axis=2)
    _, alone = tracked(front, hidden, looks=2, quality="final")
    bad = np.linalg.norm((alone.markers.positions - one.markers.positions)[8:16, lips], axis=2)
    assert off.mean() < 0.3 * bad.mean()


def test_cameras_that_do_not_fit_are_refused(tracked, pair, tmp_path) -> None:
    front, side = clip(tmp_path / "front.mp4", 12), clip(tmp_path / "side.mp4", 12)
    asked = {"views": (side,), "calibration": pair}
    with pytest.raises(InputError, match=r"cameras disagree about the face by \d+ % of its"):
        tracked(front, by_two(12), **asked, cameras=("side", "front"))
    with pytest.raises(InputError, match=r"2 cameras, front, side, for 1 video; name"):
        tracked(front, one_head, calibration=pair)
    with pytest.raises(InputError, match=r"has no camera 'back'; there are front, side"):
        tracked(front, one_head, calibration=pair, cameras=("back",))
    with pytest.raises(InputError, match="no frame in which two cameras see a face"):
        tracked(front, lambda n: [] if (n < 12) == (n % 12 < 6) else by_two(12)(n), **asked)
    fast = clip(tmp_path / "fast.mp4", 12, rate=30)
    with pytest.raises(InputError, match="the videos have 24 and 30 frames per second"):
        tracked(front, by_two(12), views=(fast,), calibration=pair)
    fitting = pair.read_text()
    pair.write_text(fitting.replace(f"size = [{WIDTH}", f"size = [{2 * WIDTH}"))
    with pytest.raises(InputError, match=r"front was calibrated at .*neither cropped nor rotated"):
        tracked(front, one_head, calibration=pair, cameras=("front",))
    pair.write_text(fitting.replace("rotation = [0, 0.", "turned = [0, 0."))
    with pytest.raises(InputError, match=r"side has no rotation and translation; calibrate the"):
        tracked(front, by_two(12), **asked)
    with pytest.raises(ValidationError, match="views has no effect without calibration"):
        tracked(front, by_two(12), views=(side,))


def test_frames_that_one_camera_sees_are_gaps_and_profiles_lose_markers(
    tracked, pair, tmp_path
) -> None:
    front, side = clip(tmp_path / "front.mp4", 12), clip(tmp_path / "side.mp4", 10)
    result, take = tracked(
        front,
        lambda n: [] if n in (3, 4) else by_two(12)(n),
        **{"views": (side,), "calibration": pair},
    )
    assert take.frame_count == 10
    np.testing.assert_array_equal(np.flatnonzero(~take.markers.visible.any(axis=1)), [3, 4])
    assert any("only one camera sees a face in 2 of 10 frames" in n for n in result.notes)
    turn = Rotation.from_euler("y", -60, degrees=True).as_matrix()
    result, take = tracked(front, lambda n: [head_points() @ turn.T + (0, 0, -600)])
    assert len(take.markers.names) < len(LANDMARKS.names)
    assert take.markers.confidence.shape == take.markers.visible.shape
    assert any("never seen, left out" in note for note in result.notes)


def test_pictures_are_a_video_too(tracked, tmp_path) -> None:
    for number in (1001, 1002, 1004, 1005):
        write_image(tmp_path / f"shot.{number}.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    _, take = tracked(tmp_path / "shot.1001.png", one_head, video_rate=25)
    assert (take.rate, take.frame_count) == (25, 5)
    assert take.markers.visible.all()  # one missing picture is bridged


def nobody(number: int):
    raise AssertionError(f"picture {number} is looked at again")


def two_heads(number: int):
    """One of two faces is lost for a while; the other is not to be taken for it."""
    near, far = turning_head(number, at=(60, 0, -600)), turning_head(number, at=(-90, 0, -700))
    return [far] if 15 <= number < 25 else [near, far]


def assert_same_take(one, other) -> None:
    assert one.markers.names == other.markers.names
    assert (one.rate, one.first_frame, one.video) == (other.rate, other.first_frame, other.video)
    for name in ("positions", "visible", "confidence"):
        np.testing.assert_array_equal(getattr(one.markers, name), getattr(other.markers, name))
    assert one.source.names == other.source.names
    np.testing.assert_array_equal(one.source.values, other.source.values)


@pytest.mark.parametrize("stamps", [[], [0, 33, 67, 100, 145, 200, 240, 267, 300, 500, 533, 567]])
def test_parts_make_the_same_take_as_the_whole(tracked, tmp_path, stamps) -> None:
    video = tmp_path / "a.mp4"
    if stamps:  # pictures between two frames belong to one part
        write_numbered(video, stamps, base=Fraction(1, 1000), rate=Fraction(30))
        cuts = ((1, 4), (5, 9), (10, 18))
        starts = (0, 4, 8)
    else:
        clip(video, 40)
        cuts, starts = ((1, 20), (21, 40)), (0, 20)
    asked = {"face": "right", "quality": "final", "looks": 2}
    _, whole = tracked(video, two_heads, **asked)
    parts = []
    for (first, last), start in zip(cuts, starts, strict=True):
        parts.append(tmp_path / f"part.{first}.usdc")
        tracked(
            video,
            two_heads,
            first=start,
            **{"part": True, "frames": f"{first}-{last}", "out": parts[-1]},
            quality="final",
            looks=2,
        )
    _, joined = tracked(video, nobody, parts=tuple(parts), **asked)
    assert_same_take(joined, whole)
    # what no part holds is looked at
    _, rest = tracked(video, two_heads, parts=tuple(parts[1:]), **asked)
    assert_same_take(rest, whole)


def test_a_part_of_something_else_is_refused(tracked, tmp_path) -> None:
    video, other = clip(tmp_path / "a.mp4", 12), clip(tmp_path / "b.mp4", 13)
    part = tmp_path / "part.usdc"
    tracked(video, one_head, part=True, frames="1-6", out=part)
    with pytest.raises(InputError, match=r"part\.usdc: was made with another video than this take"):
        tracked(other, one_head, parts=(part,))
    with pytest.raises(InputError, match=r"part\.usdc: was made with another --quality than"):
        tracked(video, one_head, parts=(part,), quality="final")
    tracked(video, one_head)
    with pytest.raises(InputError, match=r"x\.take\.usda: is no part of a tracked video; make it"):
        tracked(video, one_head, parts=(tmp_path / "x.take.usda",), out=tmp_path / "y.take.usda")
    with pytest.raises(ValidationError, match="neutral has no effect with part"):
        tracked(video, one_head, part=True, neutral=3)
    layer = Sdf.Layer.FindOrOpen(str(part))
    (made_from,) = (each for each in layer.rootPrims[0].attributes if "madeFrom" in each.name)
    for damaged in ([], list(made_from.default)[:1]):
        made_from.default = Vt.TokenArray(damaged)
        layer.Save()
        with pytest.raises(InputError, match=r"part\.usdc: was made with another"):
            tracked(video, one_head, parts=(part,))


def test_a_killed_run_goes_on_where_it_was(tracked, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(step, "_STRETCH_PICTURES", 8)
    video = clip(tmp_path / "a.mp4", 40)
    _, whole = tracked(video, one_head)
    kept = work_folder(tmp_path / "x.take.usda", "detections")
    assert not kept.exists()

    def killed(number: int):
        if number == 20:
            raise KeyboardInterrupt
        return one_head(number)

    with pytest.raises(KeyboardInterrupt):
        tracked(video, killed)
    assert len(list(kept.iterdir())) == 2
    looked: list[int] = []

    def rest(number: int):
        looked.append(number)
        return one_head(number)

    _, again = tracked(video, rest, first=16, neutral=whole.markers.neutral_frame)
    assert_same_take(again, whole)
    assert len(looked) == 24
    assert not kept.exists()
    with pytest.raises(KeyboardInterrupt):
        tracked(video, killed)
    video.write_bytes(clip(tmp_path / "b.mp4", 39).read_bytes())  # another video: all anew
    looked.clear()
    _, other = tracked(video, lambda n: looked.append(n) or one_head(n))
    assert (len(looked), other.frame_count) == (39, 39)
    assert not kept.exists()
    with pytest.raises(InputError, match="2 faces"):  # nothing is left behind
        tracked(video, lambda n: one_head(n) if n < 20 else two_heads(n - 20))
    assert not kept.exists()


def test_a_link_in_the_place_of_what_is_kept_is_not_followed(
    tracked, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(step, "_STRETCH_PICTURES", 8)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    work_folder(tmp_path / "x.take.usda", "detections").symlink_to(elsewhere)
    with pytest.raises(InputError, match=r"is a link where usdface keeps a folder"):
        tracked(clip(tmp_path / "a.mp4", 24), one_head)
    assert list(elsewhere.iterdir()) == []


def test_a_damaged_part_is_refused(tracked, tmp_path) -> None:
    video, part = clip(tmp_path / "a.mp4", 12), tmp_path / "part.usda"
    tracked(video, one_head, part=True, frames="1-12", out=part)
    whole = part.read_text()
    for old, new, message in (
        ("counts:shape = [12, 2]", "counts:shape = [2, 12]", "its arrays are inconsistent"),
        ("landmarks:shape = [12, 205, 3]", "landmarks:shape = [12, 3, 205]", "are inconsistent"),
        ("scores:shape = [12, 12]", "scores:shape = [12, 13]", "face:detections:scores is damaged"),
        ("float[] face:detections:landmarks =", "float[] other =", "landmarks is missing; make it"),
        ("uniform token[] face:detections:madeFrom =", "uniform token[] made =", "is missing"),
    ):
        assert old in whole
        part.write_text(whole.replace(old, new))
        with pytest.raises(InputError, match=message):
            tracked(video, nobody, parts=(part,), out=tmp_path / "y.take.usda")
    assert not (tmp_path / "y.take.usda").exists()


@pytest.mark.fixtures("models", "video_pyfeat")
def test_a_recorded_face_is_tracked_by_the_model_itself(shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("mediapipe", reason="the extra usdface[track] is not installed")
    model = shared_data / "models" / "face_landmarker.task"
    video = shared_data / "video_pyfeat" / "single_face.mp4"
    result = execute(
        TrackSpec(video=video, out=tmp_path / "x.take.usda", model=model, frames="20-34")
    )
    take = read_take(tmp_path / "x.take.usda")
    markers = take.markers
    assert (take.rate, take.first_frame, take.frame_count) == (30, 20, 15)
    assert result.figures["face_share"] == 1.0
    assert not take.warnings
    assert len(take.source.names) == 52
    place = dict(zip(markers.names, markers.positions.mean(axis=0), strict=True))
    assert place["brow_middle_L1"][1] > place["eye_outer_L1"][1] > place["nose_tip_1"][1]
    assert place["nose_tip_1"][1] > place["lip_upper_1"][1] > place["chin_4"][1]
    assert place["mouth_corner_L1"][0] > place["lip_lower_4"][0] > place["mouth_corner_R1"][0]
    assert place["nose_tip_1"][2] > place["mouth_corner_L1"][2] > place["temple_L1"][2]
    assert not markers.rigid  # `clean` weights each landmark by how far its part moves
    skull = markers.positions[:, [markers.names.index(name) for name in LANDMARKS.rigid]]
    pose = align_rigid(skull, skull[0])
    still = skull[0] @ pose.rotations.transpose(0, 2, 1) + pose.translations[:, None]
    assert np.sqrt(((skull - still) ** 2).sum(axis=2).mean()) < 1.5
