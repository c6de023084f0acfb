"""Every text format: what was written comes back, in mm, Y up, at the right rate and frame."""

import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.capture import text_samples as samples
from tests.regenerate import REPOSITORY
from usdface.capture.marker_take import Capture
from usdface.capture.sniff import FORMATS, read_capture, recognise_format
from usdface.capture.text_table import csv_rows
from usdface.core.errors import InputError

Z_UP_TO_Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
Put = Callable[[str], Path]


@pytest.fixture
def put(tmp_path: Path) -> Put:
    """Write a text, under a name that tells nothing, and return its path."""

    def write(text: str, encoding: str = "utf-8") -> Path:
        path = tmp_path / "kitchen.dat"
        path.write_bytes(text.encode(encoding))
        return path

    return write


def marker_positions(capture: Capture) -> np.ndarray:
    assert capture.take.markers is not None
    assert capture.take.markers.names == samples.NAMES
    return capture.take.markers.positions


def noted(capture: Capture, words: str) -> bool:
    return any(words in note for note in capture.notes)


def test_every_text_format_has_a_sample():
    assert {"c3d", "weights-npy", *samples.TEXTS} == {known.name for known in FORMATS}


@pytest.mark.parametrize("name", samples.TEXTS)
def test_a_format_is_told_by_its_content_whatever_the_extension(put, name):
    assert recognise_format(put(samples.TEXTS[name]())).name == name


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", samples.TEXTS)
def test_encodings_and_line_ends_of_other_systems_change_nothing(put, name, encoding):
    plain = read_capture(put(samples.TEXTS[name]()))
    other = read_capture(put(samples.TEXTS[name]().replace("\n", "\r\n"), encoding))
    assert other.notes == plain.notes
    for kind in ("markers", "source"):
        one, two = getattr(plain.take, kind), getattr(other.take, kind)
        if one is not None:
            field = "positions" if kind == "markers" else "values"
            np.testing.assert_array_equal(getattr(two, field), getattr(one, field))


@pytest.mark.parametrize(
    ("text", "rate", "first_frame", "to_y_up", "atol"),
    [
        (samples.trc(), 100, 5, np.eye(3), 1e-4),
        (samples.vicon_csv(), 120, 1, Z_UP_TO_Y_UP, 1e-4),
        (samples.motive_csv(), 240, 0, np.eye(3), 1e-3),
    ],
    ids=["trc", "vicon", "motive"],
)
def test_markers_come_back_in_mm_with_y_up(put, text, rate, first_frame, to_y_up, atol):
    capture = read_capture(put(text))
    np.testing.assert_allclose(
        marker_positions(capture), samples.positions() @ to_y_up.T, atol=atol
    )
    assert (capture.take.rate, capture.take.first_frame) == (rate, first_frame)
    assert capture.take.name == "kitchen"


@pytest.mark.parametrize("delimiter", ["\t", ",", ";"])
def test_trc_may_use_any_delimiter(put, delimiter):
    capture = read_capture(put(samples.trc(delimiter)))
    np.testing.assert_allclose(marker_positions(capture), samples.positions(), atol=1e-4)


def test_a_stated_rate_is_that_of_a_trc_file_without_one(put):
    path = put(samples.trc().replace("DataRate", "Fast"))
    assert read_capture(path, rate=100).take.rate == 100


def test_trc_between_spaces_has_one_name_per_marker(put):
    text = "\n".join(" ".join(line.split()) for line in samples.trc().splitlines())
    capture = read_capture(put(text))
    np.testing.assert_allclose(marker_positions(capture), samples.positions(), atol=1e-4)


@pytest.mark.parametrize(("unit", "mm"), [("cm", 10), ("feet", 304.8), ("inches", 25.4)])
def test_units_of_the_header_scale_to_mm(put, unit, mm):
    capture = read_capture(put(samples.trc(units=unit)))
    assert marker_positions(capture)[3, 1, 2] == pytest.approx(mm * samples.positions()[3, 1, 2])


def test_the_user_overrules_units_and_axis_and_it_is_noted(put):
    capture = read_capture(put(samples.trc(units="m")), units="mm", up="z")
    expected = samples.positions() @ Z_UP_TO_Y_UP.T
    np.testing.assert_allclose(marker_positions(capture), expected, atol=1e-4)
    assert noted(capture, "Units says m; mm is used, as requested")


def test_a_decimal_comma_is_read_where_the_comma_does_not_delimit(put):
    text = samples.vicon_csv(";").replace(".", ",")
    expected = samples.positions() @ Z_UP_TO_Y_UP.T
    np.testing.assert_allclose(marker_positions(read_capture(put(text))), expected, atol=1e-4)


def test_a_rate_may_have_a_decimal_comma_too(put):
    vicon = samples.vicon_csv(";").replace("\n120\n", "\n119.88\n").replace(".", ",")
    assert read_capture(put(vicon)).take.rate == Fraction(120_000, 1001)
    motive = samples.motive_csv().replace(",", ";").replace(".", ",")
    assert read_capture(put(motive)).take.rate == 240


def test_a_comma_in_a_motive_takes_name_hides_neither_units_nor_rate(put):
    plain = read_capture(put(samples.motive_csv()))
    named = read_capture(put(samples.motive_csv().replace("kitchen", "kitchen, again")))
    np.testing.assert_array_equal(marker_positions(named), marker_positions(plain))
    assert named.notes == plain.notes


@pytest.mark.parametrize("label", ["Unlabeled 1021", "Unlabeled_1021", "Unlabeled:1021"])
def test_unlabelled_markers_are_left_out_however_they_are_numbered(put, label):
    text = samples.vicon_csv().replace("Kim:chin", label)
    capture = read_capture(put(text))
    assert capture.take.markers.names == samples.NAMES[:3]
    assert noted(capture, f"1 unlabelled markers were left out: {label}")


@pytest.mark.parametrize(("count", "doubted"), [("012", 0), ("12.0", 0), ("13", 1), ("many", 1)])
def test_a_count_of_trc_is_a_number_however_it_is_written(put, count, doubted):
    text = samples.trc().replace(f"\t{samples.FRAMES}\t", f"\t{count}\t")
    assert noted(read_capture(put(text)), "may be cut off") == bool(doubted)


def test_markers_of_trc_without_a_name_are_left_out_and_counted(put):
    lines = samples.trc().splitlines()
    wide = [line + "\t9\t9\t9" * (1 + i % 2) for i, line in enumerate(lines[6:])]
    capture = read_capture(put("\n".join([*lines[:6], *wide]) + "\n"))
    np.testing.assert_array_equal(
        capture.take.markers.positions, read_capture(put(samples.trc())).take.markers.positions
    )
    assert "up to 2 markers a row without a name, left out" in capture.notes


def test_doubled_tabs_of_a_trc_header_are_one(put):
    lines = samples.trc().splitlines()
    lines[2] = lines[2].replace("\t", "\t\t")
    lines[3] = "Frame#\tTime\t\t" + "\t\t".join(samples.NAMES)
    capture = read_capture(put("\n".join(lines) + "\n"))
    assert capture.take.markers.names == samples.NAMES
    np.testing.assert_allclose(capture.take.markers.positions, samples.positions(), atol=1e-3)


@pytest.mark.parametrize("title", ["time_ms", "timestamp"])
def test_times_of_a_marker_table_may_be_milliseconds(put, title):
    text = samples.marker_csv().replace("time_s", title)
    slow = re.sub(r"(?m)^(\d+),([\d.]+)", lambda row: f"{row[1]},{1000 * float(row[2]):.2f}", text)
    assert read_capture(put(slow)).take.rate == 60


def without_frames(text):
    return "\n".join(line.partition(",")[2] for line in text.splitlines())


@pytest.mark.parametrize(("stated", "rate"), [({}, 60), ({"rate": 59.94}, Fraction(60_000, 1001))])
def test_times_alone_number_the_frames_of_a_marker_table(put, stated, rate):
    whole = read_capture(put(samples.marker_csv()), units="cm")
    lines = without_frames(samples.marker_csv()).splitlines()
    take = read_capture(put("\n".join(lines)), units="cm", **stated).take
    assert (take.rate, take.first_frame) == (rate, 1)
    np.testing.assert_array_equal(take.markers.positions, marker_positions(whole))
    del lines[5]
    gap = read_capture(put("\n".join(lines)), units="cm").take
    assert np.flatnonzero(~gap.markers.visible.any(axis=1)).tolist() == [4]


@pytest.mark.parametrize("ticks", [1e3, 1e6, 1e9])
def test_times_count_milli_micro_or_nanoseconds(put, ticks):
    rows = "".join(f"{ticks * (10 + i / 60):.0f},0.{i % 7},0.{i % 5}\n" for i in range(90))
    take = read_capture(put("timestamp,jawOpen,smile\n" + rows)).take
    assert (take.rate, take.frame_count) == (60, 90)


@pytest.mark.parametrize(
    "bone",
    [
        ("head.x", "head.y", "head.z", "head.w"),
        ("Head_Rotation_X", "Head_Rotation_Y", "Head_Rotation_Z"),
    ],
)
def test_rotations_of_a_bone_are_no_marker(put, bone):
    markers = [f"{name}.{axis}" for name in ("brow", "chin", "nose") for axis in "xyz"]
    titles = ["frame", "time_s", *bone, *markers]
    rows = [[i, i / 60, *range(len(bone)), *range(i, i + 9)] for i in range(20)]
    text = "\n".join(",".join(map(str, row)) for row in [titles, *rows]) + "\n"
    capture = read_capture(put(text))
    assert capture.take.markers.names == ("brow", "chin", "nose")
    assert noted(capture, "columns other than markers left out")


def test_markers_at_uneven_times_without_frame_numbers_are_refused(put):
    lines = without_frames(samples.marker_csv()).splitlines()
    for row in range(2, len(lines), 2):
        time, _, rest = lines[row].partition(",")
        lines[row] = f"{float(time) + 0.4 / 60},{rest}"
    with pytest.raises(InputError, match="uneven times"):
        read_capture(put("\n".join(lines)))


@pytest.mark.parametrize("name", ["trc", "vicon_csv", "motive_csv", "marker_csv"])
def test_a_row_written_twice_is_read_once_and_another_of_that_frame_is_refused(put, name):
    text = getattr(samples, name)()
    plain = read_capture(put(text))
    lines = text.rstrip("\n").splitlines()
    capture = read_capture(put("\n".join([*lines, lines[-1]])))
    np.testing.assert_array_equal(marker_positions(capture), marker_positions(plain))
    assert noted(capture, f"1 row written twice, read once: line {len(lines) + 1}")
    other = re.sub(r"\d(?=\D*$)", lambda digit: str(9 - int(digit[0])), lines[-1])
    with pytest.raises(InputError, match=rf"line {len(lines) + 1}: .* must ascend"):
        read_capture(put("\n".join([*lines, other])))


def test_a_tiny_weight_of_ifacialmocap_may_have_an_exponent(put):
    text = re.sub(r"JawOpen-\d+", "JawOpen-1.5e-05", samples.ifacialmocap())
    clip = read_capture(put(text)).take.source
    np.testing.assert_allclose(clip.values[:, clip.names.index("JawOpen")], 1.5e-7)


def test_a_text_with_a_p_second_is_no_c3d(put):
    with pytest.raises(InputError, match="not a known capture format"):
        read_capture(put("FPS,120\nframe,x\n1,2\n"))


def test_an_empty_file_is_called_empty(put):
    with pytest.raises(InputError, match=r"the file is empty \(0 bytes\)"):
        read_capture(put(""))


def test_units_overrule_openface_too(put):
    mm, cm = (read_capture(put(samples.openface_csv()), units=units) for units in (None, "cm"))
    scaled = 10 * mm.take.markers.positions
    np.testing.assert_allclose(cm.take.markers.positions, scaled, rtol=1e-6)


@pytest.mark.parametrize("hidden", ["", "NaN", "0", "-9999.99"])
@pytest.mark.parametrize("make", [samples.trc, samples.vicon_csv, samples.motive_csv])
def test_cells_that_hold_no_position_are_gaps_of_one_marker(put, make, hidden):
    text = make()
    delimiter = "\t" if make is samples.trc else ","
    lines = text.splitlines()
    cells = lines[-2].split(delimiter)
    at = 12 if make is samples.motive_csv else 2
    cells[at : at + 3] = [hidden] * 3
    lines[-2] = delimiter.join(cells)
    markers = read_capture(put("\n".join(lines))).take.markers
    assert markers is not None
    assert np.argwhere(~markers.visible).tolist() == [[samples.FRAMES - 2, 0]]
    np.testing.assert_array_equal(markers.positions[-2, 0], markers.positions[-3, 0])


def test_a_frame_without_a_row_is_a_gap_of_every_marker_and_is_noted(put):
    lines = samples.trc().splitlines()
    del lines[9]
    capture = read_capture(put("\n".join(lines)))
    assert capture.take.frame_count == samples.FRAMES
    assert capture.take.markers is not None
    assert not capture.take.markers.visible[3].any()
    assert noted(capture, "1 of 12 frames have no row")
    assert noted(capture, "NumFrames says 12, 11 found: the file may be cut off")


def test_other_blocks_of_a_vicon_file_are_named_and_left_out(put):
    assert noted(read_capture(put(samples.vicon_csv())), "blocks left out: Devices")


def test_a_vicon_file_may_begin_with_many_events(put):
    rows = "".join(f"Kim,General,Event {number},{number / 10},\n" for number in range(40))
    events = f"Events\n120\nSubject,Context,Name,Time (s),Description\n{rows}\n"
    capture = read_capture(put(events + samples.vicon_csv()))
    assert noted(capture, "blocks left out: Events")
    np.testing.assert_array_equal(
        marker_positions(capture), marker_positions(read_capture(put(samples.vicon_csv())))
    )


@pytest.mark.parametrize("labelled", [True, False], ids=["Motive 2 and 3", "Motive 1"])
def test_solved_markers_of_motive_are_left_out_whatever_its_header_rows(put, labelled):
    capture = read_capture(put(samples.motive_csv(labelled)))
    np.testing.assert_allclose(marker_positions(capture), samples.positions(), atol=1e-3)
    assert noted(capture, "Rigid Body, Rigid Body Marker")
    assert noted(capture, "1 unlabelled markers were left out: Unlabeled 1021")


def test_a_timecode_column_of_motive_starts_the_take(put):
    lines = samples.motive_csv().splitlines()
    for at, line in enumerate(lines[2:], 2):
        first, second, rest = line.split(",", 2)
        stamp = "TimeCode" if first == "Frame" else "" if at < 8 else "15:26:46:12.02"
        lines[at] = f"{first},{second},{stamp},{rest}"
    capture = read_capture(put("\n".join(lines)))
    assert capture.take.timecode_start == "15:26:46:12"
    assert noted(capture, "begins at sub-frame 02 of the label 15:26:46:12")
    np.testing.assert_allclose(marker_positions(capture), samples.positions(), atol=1e-3)


def test_words_in_a_column_that_holds_no_marker_are_left_out(put):
    plain = samples.marker_csv()
    head, *rows = plain.splitlines()
    noted = "\n".join([f"{head},Stimulus", *(f"{row},posed_neutral" for row in rows)])
    capture = read_capture(put(noted))
    assert any("other than markers left out: Stimulus" in note for note in capture.notes)
    np.testing.assert_array_equal(
        capture.take.markers.positions, read_capture(put(plain)).take.markers.positions
    )


def test_a_plain_table_takes_its_unit_from_the_user(put):
    capture = read_capture(put(samples.marker_csv()), units="cm")
    np.testing.assert_allclose(marker_positions(capture), samples.positions(), atol=1e-4)
    assert (capture.take.rate, capture.take.first_frame) == (60, 0)


@pytest.mark.parametrize(
    ("step", "base", "rate", "timecode"),
    [(2, 60, 30, "13:59:58:26"), (1, 60, 60, "13:59:58:26"), (1, 30, 30, "13:59:58:23")],
)
def test_live_link_rate_comes_from_the_steps_and_not_from_the_base(put, step, base, rate, timecode):
    start = "13:59:58:53" if base == 60 else "13:59:58:23"
    capture = read_capture(put(samples.live_link_csv(step, base, start)))
    source = capture.take.source
    assert source is not None
    assert (capture.take.rate, source.rate, source.first_frame) == (rate, rate, 1)
    assert source.names == samples.SHAPES + samples.ROTATIONS
    np.testing.assert_array_equal(source.values, samples.weights().astype(np.float32))
    assert capture.take.timecode_start == timecode
    assert noted(capture, "counts in 60ths") == (step == 2)


def test_milliseconds_after_the_dot_of_a_live_link_timecode_time_its_rows(put):
    """As generators write them: frames that rounding repeats and skips."""
    lines = samples.live_link_csv().splitlines()
    for i in range(1, len(lines)):
        clock, ms = divmod((i + 53) * 1000 // 60, 1000)  # over a full second
        frame = int(ms / (1000 / 60))
        stamp = f"00:00:{clock:02d}:{frame:02d}.{ms:03d}"
        lines[i] = f"{stamp},{lines[i].partition(',')[2]}"
    repeated = [line.partition(".")[0] for line in lines[1:]]
    assert len(set(repeated)) < len(repeated)
    capture = read_capture(put("\n".join(lines)))
    assert noted(capture, "decimals are milliseconds of the second")
    assert (capture.take.source.rate, len(capture.take.source.values)) == (60, samples.FRAMES)
    expected = read_capture(put(samples.live_link_csv())).take.source.values
    np.testing.assert_array_equal(capture.take.source.values, expected)


def test_frames_that_live_link_dropped_are_interpolated_and_named(put):
    lines = samples.live_link_csv().splitlines()
    del lines[4:6]
    capture = read_capture(put("\n".join(lines)))
    source, weights = capture.take.source, samples.weights()
    assert source is not None
    expected = weights[2] + (weights[5] - weights[2]) * np.array([[1], [2]]) / 3
    np.testing.assert_allclose(source.values[3:5], expected, rtol=1e-6)
    np.testing.assert_array_equal(source.values[5:], weights[5:].astype(np.float32))
    assert source.gaps == ((4, 5),)
    assert noted(
        capture, "2 of 12 frames were dropped by the recorder and are interpolated: frames 4-5"
    )


def frozen_recording(still):
    """A Live Link take, 60 frames at 30 a second; rows 20 to 39 repeat row 19, or nearly."""
    lines = (samples.live_link_csv() * 6).splitlines()
    rng = np.random.default_rng(0)
    rows = rng.uniform(0.1, 0.9, (60, lines[0].count(",") - 1))
    rows[20:40] = rows[19] if still else rows[19] + rng.normal(0, 1e-3, rows[20:40].shape)
    stamps = [
        f"13:00:{row // 30:02d}:{2 * (row % 30):02d}.250,{len(each)}"
        for row, each in enumerate(rows)
    ]
    text = [",".join([stamp, *map(str, each)]) for stamp, each in zip(stamps, rows, strict=True)]
    return "\n".join([lines[0], *text]), rows


def test_a_stream_that_froze_is_a_gap_of_the_take(put):
    text, rows = frozen_recording(still=True)
    capture = read_capture(put(text))
    assert capture.take.source.gaps == ((21, 40),)
    line = rows[19] + (rows[40] - rows[19]) * np.arange(1, 21)[:, None] / 21
    np.testing.assert_allclose(capture.take.source.values[20:40], line, rtol=1e-5)
    assert noted(capture, "the stream froze; treated as a gap, and interpolated: frames 21-40")


def test_a_face_that_keeps_still_before_a_device_is_no_gap(put):
    text, rows = frozen_recording(still=False)
    capture = read_capture(put(text))
    assert capture.take.source.gaps == ()
    np.testing.assert_allclose(capture.take.source.values, rows, rtol=1e-5)


def test_a_row_without_a_face_is_interpolated_and_counted(put):
    lines = samples.live_link_csv().splitlines()
    lines[4] = lines[4].split(",")[0] + ",0," + "," * 5
    capture = read_capture(put("\n".join(lines)))
    assert capture.take.frame_count == samples.FRAMES
    assert noted(capture, "1 row without a face")


def test_rows_without_a_face_at_the_ends_are_left_out_and_not_said_to_be_interpolated(put):
    lines = samples.live_link_csv().splitlines()
    for row in (1, 2, 5, 12):
        lines[row] = f"{lines[row].partition(',')[0]},0"
    capture = read_capture(put("\n".join(lines)))
    assert capture.take.frame_count == samples.FRAMES - 3
    assert capture.take.timecode_start == "13:59:58:28"
    assert noted(capture, "1 row without a face, interpolated")
    assert noted(capture, "1 row without a face at the end, left out")
    assert noted(capture, "2 frames without a face at the start, left out: the take begins 0.067 s")
    assert noted(capture, "a video that began with the recording needs --video-offset -0.067")


@pytest.mark.parametrize(("column", "value", "large"), [(2, "9.5", True), (-1, "-2.5", False)])
def test_a_weight_that_no_device_measures_is_named_and_an_angle_is_not(put, column, value, large):
    lines = samples.live_link_csv().splitlines()
    cells = lines[5].split(",")
    name = lines[0].split(",")[column]
    cells[column] = value
    lines[5] = ",".join(cells)
    capture = read_capture(put("\n".join(lines)))
    assert capture.take.source.values[4, capture.take.source.names.index(name)] == float(value)
    assert (
        noted(capture, f"{name} is 9.5 at frame 5, and weights are about 0 to 1; 1 weight") == large
    )
    assert noted(capture, "beyond 2") == large


def test_a_recording_through_midnight_goes_on(put):
    capture = read_capture(put(samples.live_link_csv(start="23:59:59:53")))
    assert capture.take.frame_count == samples.FRAMES
    assert capture.take.timecode_start == "23:59:59:26"


def test_face_cap_times_are_milliseconds(put):
    capture = read_capture(put(samples.face_cap()))
    source = capture.take.source
    assert source is not None
    assert source.rate == Fraction(60)
    np.testing.assert_array_equal(source.values[:, :3], samples.weights()[:, :3].astype(np.float32))
    degrees = dict(zip(source.names[3:], np.degrees(source.values[5, 3:]), strict=True))
    assert degrees["headRotationZ"] == pytest.approx(30)
    assert degrees["rightEyeRotationY"] == pytest.approx(4)


def test_face_cap_samples_at_uneven_times_are_resampled(put):
    times = np.cumsum(np.random.default_rng(0).uniform(5, 28, 400)).round()  # [ms]
    rows = [f"k,{time:.0f},{'0,' * 10}{time / 10000:.6f}" for time in times]
    capture = read_capture(put("\n".join(["bs,JawOpen", *rows])))
    source = capture.take.source
    assert source is not None
    assert noted(capture, "resampled by their times to 60 frames per second")
    slope = np.diff(source.values[:, 0]) * 10 * float(source.rate)
    np.testing.assert_allclose(slope, 1, atol=1e-3)  # a straight line in time stays one


@pytest.mark.parametrize(("separator", "mark"), [("\n", "-"), ("___iFacialMocap", "&")])
def test_ifacialmocap_weights_run_to_one_and_angles_are_radians(put, separator, mark):
    capture = read_capture(put(samples.ifacialmocap(separator, mark)))
    source = capture.take.source
    assert source is not None
    np.testing.assert_allclose(source.values[:, :3], samples.weights()[:, :3].round(2), atol=1e-6)
    np.testing.assert_allclose(source.values[0, 3:6], [-np.pi / 2, 0, np.pi / 4], rtol=1e-6)
    assert noted(capture, "60 frames per second assumed")


def test_ifacialmocaps_tracking_is_no_shape_and_frames_without_a_face_are_left_out(put):
    plain = samples.ifacialmocap().splitlines()
    seen = [place not in (0, 3) for place in range(len(plain))]
    lines = [f"trackingStatus-{int(on)}|{line}" for on, line in zip(seen, plain, strict=True)]
    capture = read_capture(put("\n".join(lines) + "\n"))
    source = capture.take.source
    assert source is not None
    assert "trackingStatus" not in source.names
    wanted = samples.weights()[1:, :3].round(2)
    wanted[2] = (wanted[1] + wanted[3]) / 2
    np.testing.assert_allclose(source.values[:, :3], wanted, atol=1e-6)
    assert noted(capture, "1 frame without a face, interpolated")
    assert noted(capture, "1 frame without a face at the start, left out")


def test_openface_gives_landmarks_y_up_and_action_units_to_one(put):
    capture = read_capture(put(samples.openface_csv()))
    markers, source = capture.take.markers, capture.take.source
    assert markers is not None
    assert source is not None
    assert markers.names == ("landmark_0", "landmark_1", "landmark_2", "landmark_3")
    seen = np.arange(samples.FRAMES) != 3
    expected = (samples.positions() + np.array([0, 0, 500])) * (1, -1, -1)
    np.testing.assert_allclose(markers.positions[seen], expected[seen], atol=1e-3)
    np.testing.assert_array_equal(markers.visible.all(axis=1), seen)
    np.testing.assert_allclose(markers.confidence[:, 0], np.where(seen, 0.98, 0), rtol=1e-6)
    np.testing.assert_allclose(source.values[:, 0], 0.02 * np.arange(12), atol=1e-6)
    np.testing.assert_allclose(source.values[:, 1], 1)
    assert (source.names, source.rate, source.first_frame) == (("AU01", "AU12"), 25, 1)
    assert source.gaps == ((4, 4),)


def test_openface_timestamps_that_count_rows_are_doubted(put):
    lines = samples.openface_csv().splitlines()
    for i in range(1, len(lines)):
        cells = lines[i].split(", ")
        lines[i] = ", ".join([*cells[:2], f"{(i - 1) / 1000:.3f}", *cells[3:]])
    path = put("\n".join(lines))
    assert noted(read_capture(path), "1000 frames per second by the timestamps")
    stated = read_capture(path, rate=25.0)
    assert (stated.take.rate, noted(stated, "by the timestamps")) == (25, False)


def test_openface_without_landmarks_is_a_take_of_weights(put):
    text = samples.openface_csv().replace(" X_", " left_")
    capture = read_capture(put(text))
    assert capture.take.markers is None
    assert capture.take.source is not None


def test_a_named_format_overrules_the_content(put):
    text = "take of tuesday\n" + samples.vicon_csv()
    text = text.replace("Devices\n1000\n", "\n" * 12 + "Devices\n1000\n")
    path = put(text)
    assert read_capture(path, format="vicon-csv").take.frame_count == samples.FRAMES


def test_the_recorded_live_link_take_is_thirty_frames_per_second(shared_data):
    capture = read_capture(shared_data / "livelink_alex/alex_rom_3.csv")
    source = capture.take.source
    assert source is not None
    assert source.values.shape == (4030 + 3, 61)
    assert (source.rate, capture.take.timecode_start) == (30, "13:13:04:15")
    assert noted(
        capture, "3 of 4033 frames were dropped by the recorder and are interpolated: frames 597"
    )
    assert source.values.max() == pytest.approx(1.05, abs=0.06)


def test_the_recorded_live_link_take_at_sixty_has_no_frame_missing(shared_data):
    path = shared_data / "livelink_jmtechart/MySlate_3_Jason_Millers_iPhone.csv"
    capture = read_capture(path)
    table = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=range(2, 63))
    assert capture.take.source is not None
    assert capture.take.rate == 60
    np.testing.assert_array_equal(capture.take.source.values, table.astype(np.float32))


@pytest.mark.parametrize("name", ["CheeksMoCap", "EyebrowsMoCap"])
def test_recorded_markers_are_the_same_as_table_and_as_c3d(shared_data, name):
    folder = shared_data / "markers_animface"
    table = read_capture(folder / f"{name}.csv", units="cm").take
    c3d = read_capture(folder / f"{name}.c3d", up="y").take
    assert table.markers is not None
    assert c3d.markers is not None
    assert table.rate == c3d.rate
    assert len(table.markers.names) == len(c3d.markers.names)
    np.testing.assert_allclose(table.markers.positions, c3d.markers.positions, atol=0.05)


def test_the_recorded_trc_is_read_to_its_end(shared_data):
    capture = read_capture(shared_data / "c3d/markers.trc")
    assert capture.take.markers is not None
    assert capture.take.markers.positions.shape == (93, 51, 3)
    np.testing.assert_allclose(
        capture.take.markers.positions[0, 0], [733.7041, 80.9832, 191.8668], rtol=1e-6
    )
    assert noted(capture, "NumFrames says 652, 93 found")


def test_the_documentation_says_of_every_format_what_is_read_and_what_is_not():
    page = (REPOSITORY / "docs/formats.md").read_text(encoding="utf-8")
    table = page.partition("\n## ")[0]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| `")]
    assert all(len(row) == 4 and all(cell.strip() for cell in row) for row in rows)
    assert {row[0].strip(" `") for row in rows} == {known.name for known in FORMATS} | {"--format"}


def test_separators_of_unicode_in_a_cell_are_no_ends_of_rows(tmp_path) -> None:
    path = tmp_path / "places.csv"
    path.write_bytes('marker,note\r\nA,one\u2028two\r\nB,"three\nfour"\r\n'.encode())
    (_, first), (where, second) = csv_rows(path, ("marker",))
    assert first["note"] == "one\u2028two"
    assert (where, second["note"]) == ("line 4", "three\nfour")
