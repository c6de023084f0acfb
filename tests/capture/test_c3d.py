"""Our C3D reader and writer against ezc3d, against each other, and against damage."""

import struct
from collections.abc import Iterator
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from tests.c3d_write import write_c3d
from usdface.capture.axes import mm_per_unit
from usdface.capture.c3d import open_c3d, read_c3d_take
from usdface.capture.c3d_parameters import Parameters
from usdface.capture.marker_take import CaptureOptions
from usdface.core.errors import InputError

BTK_SAME = (
    "pc_int.c3d",
    "sgi_int.c3d",
    "DEC_INT.C3D",
    "pc_real.c3d",
    "sgi_real.c3d",
    "Dec_real.c3d",
)


@pytest.fixture
def take() -> tuple[np.ndarray, np.ndarray, list[str]]:
    rng = np.random.default_rng(0)
    positions = rng.normal(0, 100, (40, 5, 3)).astype(np.float32)
    visible = rng.random((40, 5)) > 0.2
    return positions, visible, ["brow_L", "brow_R", "lip_U", "lip_D", "nose"]


def read_with_ezc3d(path: Path) -> tuple[np.ndarray, np.ndarray]:
    data = ezc3d.c3d(str(path))["data"]
    return data["points"][:3].transpose(2, 1, 0), data["meta_points"]["residuals"][0].T >= 0


def test_written_points_come_back_with_their_gaps(take, tmp_path):
    positions, visible, labels = take
    write_c3d(tmp_path / "take.c3d", positions, visible, labels, rate=119.88, first_frame=1001)
    file = open_c3d(tmp_path / "take.c3d")
    points, residuals = file.read_points()
    assert file.point_labels == tuple(labels)
    assert (file.layout.first_frame, file.layout.parameters.text("POINT:UNITS")) == (1001, "mm")
    assert file.layout.rate == pytest.approx(119.88)
    np.testing.assert_array_equal(residuals >= 0, visible)
    np.testing.assert_array_equal(points[visible], positions[visible])
    assert file.layout.notes == ()


def test_ezc3d_reads_what_we_write(take, tmp_path):
    positions, visible, labels = take
    path = tmp_path / "take.c3d"
    write_c3d(path, positions, visible, labels, rate=60, first_frame=7)
    points, seen = read_with_ezc3d(path)
    header = ezc3d.c3d(str(path))["header"]["points"]
    np.testing.assert_array_equal(seen, visible)
    np.testing.assert_array_equal(points[visible], positions[visible])
    assert (header["first_frame"] + 1, header["frame_rate"]) == (7, 60.0)  # it counts from 0


def test_we_read_what_ezc3d_writes(take, tmp_path):
    positions, _, labels = take
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["data"]["points"] = np.concatenate([positions, np.ones((40, 5, 1))], 2).transpose(2, 1, 0)
    file.write(str(tmp_path / "ezc3d.c3d"))
    points, _ = open_c3d(tmp_path / "ezc3d.c3d").read_points()
    np.testing.assert_array_equal(points, positions)


def test_outputs_of_a_body_model_are_no_markers(tmp_path):
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["brow_L", "Kim:HeadAngles", "Force", "nose"]
    file["data"]["points"] = np.random.default_rng(0).normal(0, 50, (4, 4, 9))
    file["data"]["points"][3] = 1
    file.add_parameter("POINT", "ANGLES", ["HeadAngles"])
    file.add_parameter("POINT", "FORCES", ["Force"])
    file.write(str(tmp_path / "take.c3d"))
    capture = read_c3d_take(tmp_path / "take.c3d", CaptureOptions())
    assert capture.take.markers.names == ("brow_L", "nose")
    assert "left out: Kim:HeadAngles, Force" in " ".join(capture.notes)


def test_a_slice_of_frames_equals_the_same_slice_of_the_whole(take, tmp_path):
    positions, visible, labels = take
    write_c3d(tmp_path / "take.c3d", positions, visible, labels, rate=60)
    file = open_c3d(tmp_path / "take.c3d")
    np.testing.assert_array_equal(file.read_points(11, 29)[1], file.read_points()[1][11:29])
    assert file.read_points(39, 99)[0].shape == (1, 5, 3)


def test_more_frames_than_sixteen_bits_count_are_all_read(tmp_path):
    frames = 66_000
    positions = np.arange(1, frames * 6 + 1, dtype=np.float32).reshape(frames, 2, 3)
    write_c3d(tmp_path / "long.c3d", positions, np.ones((frames, 2), bool), ["a", "b"], rate=120)
    file = open_c3d(tmp_path / "long.c3d")
    assert file.layout.frame_count == frames
    np.testing.assert_array_equal(file.read_points(65_990)[0], positions[65_990:])


@pytest.mark.parametrize(
    "hidden", [("TRIAL", "LONG_FRAMES"), ("TRIAL",)], ids=["neither", "only LONG_FRAMES"]
)
def test_a_full_frame_count_is_completed_from_what_the_file_says(tmp_path, hidden):
    frames = 65_536 + 40  # 64 points of 16 bytes: a frame is two blocks, so there is no padding
    positions = np.ones((frames, 64, 3), np.float32)
    labels = [f"m{i}" for i in range(64)]
    path = tmp_path / "long.c3d"
    write_c3d(path, positions, np.ones((frames, 64), bool), labels, rate=120)
    content = bytearray(path.read_bytes())
    for name in hidden:
        at = content.index(name.encode())
        content[at : at + len(name)] = b"X" * len(name)
    path.write_bytes(content)
    assert open_c3d(path).layout.frame_count == frames


def test_more_than_255_labels_continue_in_further_parameters(tmp_path):
    labels = [f"marker_{i:03d}" for i in range(600)]
    write_c3d(tmp_path / "many.c3d", np.ones((2, 600, 3)), np.ones((2, 600), bool), labels, rate=60)
    assert open_c3d(tmp_path / "many.c3d").point_labels == tuple(labels)


def test_analog_samples_come_back_beside_the_points(take, tmp_path):
    positions, visible, labels = take
    analog = np.random.default_rng(1).normal(size=(40 * 16, 2)).astype(np.float32)
    path = tmp_path / "analog.c3d"
    write_c3d(
        path, positions, visible, labels, rate=60, analog=analog, analog_labels=["mic", "sync"]
    )
    file = open_c3d(path)
    assert (file.analog_labels, file.analog_rate) == (("mic", "sync"), 960.0)
    np.testing.assert_array_equal(file.read_analog(), analog)
    np.testing.assert_array_equal(file.read_analog(10, 12), analog[160:192])
    np.testing.assert_allclose(ezc3d.c3d(str(path))["data"]["analogs"][0].T, analog)


@pytest.mark.parametrize("name", BTK_SAME)
def test_every_byte_order_and_storage_gives_the_same_points(shared_data, name):
    one = open_c3d(shared_data / "c3d/btk" / BTK_SAME[0])
    other = open_c3d(shared_data / "c3d/btk" / name)
    (ours, residuals), (theirs, others) = one.read_points(), other.read_points()
    np.testing.assert_array_equal(residuals >= 0, others >= 0)
    seen = residuals >= 0
    # cut off, not rounded
    assert np.abs(ours - theirs)[seen].max() <= one.layout.scale * 1.01
    np.testing.assert_allclose(one.read_analog(), other.read_analog(), rtol=1e-5, atol=1e-4)
    assert one.point_labels == other.point_labels


@pytest.mark.parametrize(
    "name",
    [
        "markers_analogs.c3d",
        "btk/pc_int.c3d",
        "btk/pc_real.c3d",
        "btk/Dec_real.c3d",
        "btk/DEC_INT.C3D",
    ],
)
def test_points_and_analog_agree_with_ezc3d(shared_data, name):
    path = shared_data / "c3d" / name
    file = open_c3d(path)
    ours, residuals = file.read_points()
    points, seen = read_with_ezc3d(path)
    np.testing.assert_array_equal(residuals >= 0, seen)
    np.testing.assert_allclose(ours[seen], points[seen], rtol=1e-6)
    analog = ezc3d.c3d(str(path))["data"]["analogs"][0].T
    np.testing.assert_allclose(file.read_analog(), analog, rtol=1e-4, atol=1e-3)


def test_a_damaged_parameter_behind_sound_ones_is_noted_and_the_points_are_read(shared_data):
    file = open_c3d(shared_data / "c3d/btk/bad_parameter_section.c3d")
    assert (file.layout.point_count, file.layout.frame_count) == (45, 332)
    assert any("parameter" in note for note in file.layout.notes)


def test_recorded_points_match_the_table_that_came_with_them(shared_data):
    table = np.genfromtxt(
        shared_data / "markers_animface/CheeksMoCap.csv", delimiter=",", skip_header=1
    )
    points, _ = open_c3d(shared_data / "markers_animface/CheeksMoCap.c3d").read_points()
    in_mm = 10 * table[:, 2:].reshape(len(table), -1, 3)  # the table is in centimetres
    np.testing.assert_allclose(points, in_mm, atol=0.05)


def whole_and_damaged(path: Path) -> Iterator[tuple[str, bytes]]:
    content = path.read_bytes()
    yield "empty", b""
    yield "two bytes", content[:2]
    yield "header only", content[:512]
    yield "cut in the parameters", content[:700]
    yield "cut in the data", content[:-600]
    yield "a picture", b"\x89PNG\r\n\x1a\n" + content[8:]
    yield "processor 99", content[:515] + b"\x63" + content[516:]
    yield "data past the end", content[:16] + struct.pack("<H", 60000) + content[18:]
    yield (
        "65535 points",
        content.replace(
            b"\x04USED"[1:] + b"\x05\x00\x02\x00\x05\x00", b"USED\x05\x00\x02\x00\xff\xff"
        ),
    )


@pytest.mark.parametrize("case", range(8))
def test_damage_is_refused_with_the_file_the_place_and_the_remedy(take, tmp_path, case):
    positions, visible, labels = take
    path = tmp_path / "take.c3d"
    write_c3d(path, positions, visible, labels, rate=60)
    name, content = list(whole_and_damaged(path))[case]
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"take\.c3d.*; (export|choose|copy)"):
        open_c3d(path)
    assert name


def test_a_file_that_shrinks_while_it_is_read_names_the_frame(take, tmp_path):
    positions, visible, labels = take
    path = tmp_path / "take.c3d"
    write_c3d(path, positions, visible, labels, rate=60)
    file = open_c3d(path)
    path.write_bytes(path.read_bytes()[: file.layout.data_start + 81])
    with pytest.raises(InputError, match="frame 2: the file ended"):
        file.read_points()


def test_events_come_in_order_by_frame(take, tmp_path):
    positions, visible, names = take
    write_c3d(tmp_path / "plain.c3d", positions, visible, names, rate=120)
    file = ezc3d.c3d(str(tmp_path / "plain.c3d"))
    file.add_parameter("EVENT", "USED", [2])
    file.add_parameter("EVENT", "LABELS", ["Clap", "Slate"])
    file.add_parameter("EVENT", "CONTEXTS", ["", "General"])
    file.add_parameter("EVENT", "TIMES", np.array([[0.0, 0.0], [0.25, 0.1]]))
    file.write(str(tmp_path / "marked.c3d"))
    found = read_c3d_take(tmp_path / "marked.c3d", CaptureOptions()).take.events
    assert [event.label for event in found] == ["General Slate", "Clap"]
    np.testing.assert_allclose([event.frame for event in found], [1 + 12, 1 + 30], atol=1e-4)


def test_spare_events_beyond_the_stated_number_are_none(take, tmp_path):
    positions, visible, names = take
    write_c3d(tmp_path / "plain.c3d", positions, visible, names, rate=120)
    file = ezc3d.c3d(str(tmp_path / "plain.c3d"))
    file.add_parameter("EVENT", "USED", [1])
    file.add_parameter("EVENT", "LABELS", ["Clap", "", ""])
    file.add_parameter("EVENT", "TIMES", np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0]]))
    file.write(str(tmp_path / "marked.c3d"))
    found = read_c3d_take(tmp_path / "marked.c3d", CaptureOptions()).take.events
    assert [event.label for event in found] == ["Clap"]


def test_a_take_cut_by_another_library_counts_by_its_header(take, tmp_path):
    positions, visible, labels = take
    write_c3d(tmp_path / "whole.c3d", positions, visible, labels, rate=60, first_frame=1)
    file = ezc3d.c3d(str(tmp_path / "whole.c3d"))
    file["data"]["points"] = file["data"]["points"][:, :, 10:30]
    for name, kept in file["data"]["meta_points"].items():
        file["data"]["meta_points"][name] = kept[:, :, 10:30]
    file["header"]["points"].update(first_frame=10, last_frame=29)
    file.write(str(tmp_path / "cut.c3d"))  # TRIAL still says 1 to 40
    cut = open_c3d(tmp_path / "cut.c3d")
    assert (cut.layout.first_frame, cut.layout.frame_count) == (11, 20)
    seen = visible[10:30]
    np.testing.assert_array_equal(cut.read_points()[0][seen], positions[10:30][seen])
    assert any("TRIAL says 1 to 40, the header 11 to 30" in note for note in cut.layout.notes)


@pytest.mark.parametrize(
    ("words", "frames", "first", "note"),
    [
        ((0, 0, 0, 0), 40, 1, "TRIAL says 0 to 0, the header 1 to 40"),
        ((3, 0, 7, 0), 40, 1, "TRIAL says 3 to 7, the header 1 to 40"),
        ((70_000 % 65_536, 1, 70_039 % 65_536, 1), 40, 70_000, ""),
    ],
)
def test_no_frame_is_lost_where_trial_and_header_differ(take, tmp_path, words, frames, first, note):
    path = tmp_path / "take.c3d"
    write_c3d(path, *take, rate=60)
    content = bytearray(path.read_bytes())
    for name, pair in (("ACTUAL_START_FIELD", words[:2]), ("ACTUAL_END_FIELD", words[2:])):
        at = content.index(name.encode()) + len(name) + 5  # link, type, rank, dimensions
        struct.pack_into("<2H", content, at, *pair)
    path.write_bytes(content)
    layout = open_c3d(path).layout
    assert (layout.first_frame, layout.frame_count) == (first, frames)
    assert [note in told for told in layout.notes] == ([True] if note else [])


def test_a_parameter_that_counts_more_frames_than_there_are_is_noted(take, tmp_path):
    path = tmp_path / "take.c3d"
    write_c3d(path, *take, rate=60)
    content = bytearray(path.read_bytes())
    content[content.index(b"TRIAL") : content.index(b"TRIAL") + 5] = b"OTHER"
    struct.pack_into("<H", content, content.index(b"FRAMES") + len("FRAMES") + 4, 1000)
    path.write_bytes(content)
    layout = open_c3d(path).layout
    assert layout.frame_count == 40
    assert layout.notes == ("frames: POINT:FRAMES says 1000, the header 1 to 40; 40 read",)


@pytest.mark.parametrize("sign", [1.0, 0.01])
def test_floats_are_read_as_floats_though_the_scale_lost_its_sign(take, tmp_path, sign):
    positions, visible, labels = take
    path = tmp_path / "take.c3d"
    write_c3d(path, positions, visible, labels, rate=60)
    content = bytearray(path.read_bytes())
    struct.pack_into("<f", content, content.index(b"SCALE") + len("SCALE") + 4, sign)
    path.write_bytes(content)
    file = open_c3d(path)
    np.testing.assert_array_equal(file.read_points()[0][visible], positions[visible])
    assert any("differ in sign" in note for note in file.layout.notes)


def test_a_last_frame_beyond_sixteen_bits_adds_no_frames_of_padding(take, tmp_path):
    path = tmp_path / "take.c3d"
    write_c3d(path, *take, rate=60)
    content = bytearray(path.read_bytes())
    content[content.index(b"TRIAL") : content.index(b"TRIAL") + 5] = b"OTHER"
    struct.pack_into("<2H", content, 6, 0xFFFF, 0xFFFF)  # frames 70,000 to 70,039 say this
    path.write_bytes(content)
    assert open_c3d(path).layout.frame_count == 40


def test_numbers_go_on_in_further_parameters_as_labels_do():
    times = np.arange(600.0)
    values = {
        "EVENT:TIMES": times[:510],
        "EVENT:TIMES2": times[510:],
        "EVENT:USED": np.array([300]),
    }
    parameters = Parameters(values)
    np.testing.assert_array_equal(parameters.numbers("EVENT:TIMES"), times)
    assert parameters.number("EVENT:USED") == 300
    assert parameters.numbers("EVENT:LABELS").size == 0


def analog_take(path: Path, positions: np.ndarray, labels: list[str]) -> bytearray:
    """Write points with 16 analog channels of 7 samples a frame; return the file's bytes."""
    analog = np.random.default_rng(2).normal(size=(len(positions) * 7, 16)).astype(np.float32)
    names = [f"ch{i}" for i in range(16)]
    seen = np.ones(positions.shape[:2], bool)
    write_c3d(path, positions, seen, labels, rate=140, analog=analog, analog_labels=names)
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("third", [16, 7, 0, 112])
def test_the_files_size_settles_how_many_analog_samples_a_frame_has(take, tmp_path, third):
    """As MotionMonitor writes it: channels in the third word, samples of each in the tenth."""
    positions, _, labels = take
    path = tmp_path / "analog.c3d"
    content = analog_take(path, positions, labels)
    whole = open_c3d(path).read_analog()
    struct.pack_into("<H", content, 4, third)
    struct.pack_into("<H", content, 18, 7)
    path.write_bytes(content)
    file = open_c3d(path)
    np.testing.assert_array_equal(file.read_points()[0], positions)
    np.testing.assert_array_equal(file.read_analog(), whole)
    assert any("by the file's size" in note for note in file.layout.notes) == (third != 112)


@pytest.mark.parametrize("wrong", ["header", "parameters"])
def test_the_files_size_settles_how_many_points_a_frame_has(take, tmp_path, wrong):
    positions, _, labels = take
    path = tmp_path / "points.c3d"
    content = analog_take(path, positions, labels)
    at = 2 if wrong == "header" else content.index(b"USED") + 4 + 4
    assert struct.unpack_from("<H", content, at) == (5,)
    struct.pack_into("<H", content, at, 4)
    path.write_bytes(content)
    file = open_c3d(path)
    np.testing.assert_array_equal(file.read_points()[0], positions)
    assert "5 used by the file's size" in " ".join(file.layout.notes)


def test_points_whose_fourth_word_is_no_residual_are_seen_where_they_are(take, tmp_path):
    positions, _, labels = take
    path = tmp_path / "odd.c3d"
    write_c3d(path, positions, np.ones(positions.shape[:2], bool), labels, rate=60)
    content = bytearray(path.read_bytes())
    start = open_c3d(path).layout.data_start
    for at in range(start, start + positions.shape[0] * 80, 16):
        struct.pack_into("<f", content, at + 12, 1.708e38)
        if at < start + 16:
            content[at : at + 12] = bytes(12)
    path.write_bytes(content)
    capture = read_c3d_take(path, CaptureOptions(units="mm", up="y"))
    assert capture.take.markers.visible.sum() == positions.shape[0] * 5 - 1
    assert any("residual that the format knows" in note for note in capture.notes)


@pytest.mark.parametrize("unit", ["mete", "METERS", "cent", "mill"])
def test_a_unit_cut_to_the_writers_width_is_known(unit):
    expected = {"m": 1000.0, "c": 10.0}["c" if unit == "cent" else "m"]
    assert mm_per_unit(unit, where="x") == (1.0 if unit == "mill" else expected)
